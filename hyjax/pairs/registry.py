"""Sources of pictures with depth, each opened from one line of text.

    KIND:PATH?OPTION=VALUE&OPTION=VALUE

    folder:/data/mosd?frames=3:40:4            every fourth pair of a folder, from the one at position 3
    folder:/data/mosd?without=3:40:4           all others (mosd:/data/mosd means the same)
    folder:/data/mine?unit=tenths              whose steps are tenths of a millimetre
    capture:/data/kitchen?frames=0:225         frames of a capture with the depth that was measured
    capture:/data/kitchen?frames=0:225&depth=surface
                                               or with that of a surface fused from these frames alone
    capture:/data/kitchen?frames=0:225&depth=both
                                               or that, and what was measured where the surface is not relied on
    diml:/data/diml/train/HR                   DIML, indoor or outdoor
    nyu:/data/nyu_depth_v2_labeled.mat         NYU Depth v2
    middlebury:/data/middlebury/2014           Middlebury stereo, disparities
    rooms?seed=3                               generated rooms, which need no file
    rooms?frames=0:2000&cached=yes             the first 2000 pictures of them, kept on disk

`frames` and `without` go with every kind and take positions as `hyjax.data.frames.select_frames` does.

A new kind is a file that ends with its `PairsKind` and a place in `_KINDS`; or, outside the package, a call of
`register_pairs`."""

from pathlib import Path

from hyjax.pairs import captures, diml, folder, generated_rooms, middlebury, nyu
from hyjax.pairs.depth_pairs import SELECTION_OPTIONS, ChosenPairs, DepthPairs, PairsKind, selected
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError, did_you_mean

_KINDS = (folder.KIND, folder.MOSD, diml.KIND, nyu.KIND, middlebury.KIND, captures.KIND, generated_rooms.KIND)
PAIRS_KINDS = {kind.name: kind for kind in _KINDS}
"""Kinds of sources by name."""


def register_pairs(kind: PairsKind) -> None:
    """Add a kind to `PAIRS_KINDS`.

    Raises:
        InputError: there is one of this name.
    """
    if kind.name in PAIRS_KINDS:
        raise InputError(f"pairs: kind {kind.name!r} is registered already; choose another name")
    PAIRS_KINDS[kind.name] = kind


@checked_arguments
def open_pairs(text: str) -> DepthPairs:
    """Open a source of pairs; see this module for the syntax.

    Raises:
        InputError: an unknown kind or option, or an error of the source's own reader.
    """
    head, _, tail = text.rpartition("?") if "?" in text else (text, "", "")
    name, _, path = head.partition(":")
    kind = PAIRS_KINDS.get(name)
    if kind is None:
        raise InputError(
            f"pairs: {text!r} has an unknown kind{did_you_mean(name, PAIRS_KINDS)}; write KIND:PATH with one of "
            f"{', '.join(PAIRS_KINDS)}"
        )
    if not path and kind.has_path:
        raise InputError(f"pairs: {text!r} names no file; write {name}:PATH")
    if path and not kind.has_path:
        raise InputError(f"pairs: {name} are generated, not read from {path}; write {name} alone")
    options: dict[str, str] = {}
    for part in filter(None, tail.split("&")):
        option, equals, value = part.partition("=")
        if option not in (*kind.options, *SELECTION_OPTIONS) or not equals or option in options:
            raise InputError(
                f"pairs: {text!r} has option {part!r}; {name} takes "
                f"{', '.join((*kind.options, *SELECTION_OPTIONS))}, each once, as NAME=VALUE"
            )
        options[option] = value
    pairs = kind.open(Path(path), options)
    if kind.selects or not options.keys() & set(SELECTION_OPTIONS):
        return pairs  # an endless source has too many to name
    return ChosenPairs(pairs, selected(options, len(pairs)))
