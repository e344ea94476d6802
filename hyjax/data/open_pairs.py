"""Any source of pictures with depth from one line of text.

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

`frames` and `without` go with every kind and take positions as `hyjax.data.frames.select_frames` does."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import cast, get_args

from hyjax.data.capture_pairs import CapturePairs, Source
from hyjax.data.depth_pairs import ChosenPairs, DepthPairs
from hyjax.data.diml import open_diml
from hyjax.data.frames import select_frames
from hyjax.data.middlebury import open_middlebury
from hyjax.data.nyu import NyuPairs
from hyjax.data.open import open_capture
from hyjax.data.pair_folder import open_folder
from hyjax.errors import InputError, did_you_mean

Options = Mapping[str, str]


def open_pairs(text: str) -> DepthPairs:
    """Open a source of pairs; see this module for the syntax.

    Raises:
        InputError: an unknown kind or option, or what the source's own reader finds wrong.
    """
    head, _, tail = text.rpartition("?") if "?" in text else (text, "", "")
    kind, _, path = head.partition(":")
    if kind not in KINDS:
        raise InputError(
            f"pairs: {text!r} is of no known kind{did_you_mean(kind, KINDS)}; write KIND:PATH with one of "
            f"{', '.join(KINDS)}"
        )
    opened, known = KINDS[kind]
    if not path and kind not in PATHLESS:
        raise InputError(f"pairs: {text!r} names no file; write {kind}:PATH")
    options: dict[str, str] = {}
    for part in filter(None, tail.split("&")):
        name, equals, value = part.partition("=")
        if name not in (*known, *SELECTING) or not equals or name in options:
            raise InputError(
                f"pairs: {text!r} has option {part!r}; {kind} takes {', '.join((*known, *SELECTING))}, each once, "
                "as NAME=VALUE"
            )
        options[name] = value
    return opened(Path(path), options)


def _chosen(pairs: DepthPairs, options: Options) -> DepthPairs:
    if not options.keys() & set(SELECTING):
        return pairs  # an endless source has too many to name
    return ChosenPairs(pairs, _indices(options, len(pairs)))


def _indices(options: Options, count: int) -> list[int]:
    """Positions that `frames` names and `without` does not."""
    left_out = set(select_frames(options["without"], count)) if "without" in options else set()
    chosen = [i for i in select_frames(options.get("frames", "all"), count) if i not in left_out]
    if not chosen:
        raise InputError(f"pairs: frames without {options['without']} leave none of 0 to {count - 1}")
    return chosen


def _folder(path: Path, options: Options) -> DepthPairs:
    return _chosen(open_folder(path, options.get("unit", "millimetres")), options)


def _diml(path: Path, options: Options) -> DepthPairs:
    return _chosen(open_diml(path), options)


def _nyu(path: Path, options: Options) -> DepthPairs:
    return _chosen(NyuPairs(path), options)


def _middlebury(path: Path, options: Options) -> DepthPairs:
    return _chosen(open_middlebury(path), options)


def _capture(path: Path, options: Options) -> DepthPairs:
    capture = open_capture(path)
    depth = options.get("depth", "sensor")
    if depth not in get_args(Source):
        raise InputError(f"{path}: depth={depth} is unknown; use one of {', '.join(get_args(Source))}")
    return CapturePairs(capture, _indices(options, len(capture)), cast(Source, depth))


def _rooms(path: Path, options: Options) -> DepthPairs:
    from hyjax.data.generated_rooms import GeneratedRooms

    if str(path) != ".":
        raise InputError(f"pairs: rooms are generated, not read from {path}; write rooms or rooms?seed=3")

    def number(name: str, default: int) -> int:
        value = options.get(name, str(default))
        if not value.isdecimal():
            raise InputError(f"pairs: rooms?{name}={value} must be a whole number, 0 or more")
        return int(value)

    if options.keys() & set(SELECTING):
        parts = [part.split(":") for part in options.get("frames", "all").split(",")]
        if not all(part[min(1, len(part) - 1)].strip().isdecimal() for part in parts):
            raise InputError("pairs: rooms are endless; name the first and the last as in rooms?frames=0:2000")
    cached = options.get("cached", "no")
    if cached not in ("yes", "no"):
        raise InputError(f"pairs: rooms?cached={cached} must be yes or no")
    rooms = GeneratedRooms(
        number("seed", 0), size=number("size", 352), views=number("views", 4), cached=cached == "yes"
    )
    return _chosen(rooms, options)


SELECTING = ("frames", "without")
KINDS: dict[str, tuple[Callable[[Path, Options], DepthPairs], tuple[str, ...]]] = {
    "folder": (_folder, ("unit",)),
    "mosd": (_folder, ()),
    "diml": (_diml, ()),
    "nyu": (_nyu, ()),
    "middlebury": (_middlebury, ()),
    "capture": (_capture, ("depth",)),
    "rooms": (_rooms, ("seed", "size", "views", "cached")),
}
"""Of each kind, what opens it and the options that it takes beside `SELECTING`."""
PATHLESS = ("rooms",)
