"""A plain folder of pictures and depth maps of the same names.

    NAME_rgb.png|jpg + NAME_depth.png             side by side, or
    rgb/NAME.png|jpg + depth/NAME.png             in two subfolders

Depth maps have one 16-bit channel in millimetres unless said otherwise, 0 or 65535 where there is no reading."""

from collections.abc import Callable
from pathlib import Path

from hyjax.data.capture_files import read_colour
from hyjax.data.depth_pairs import DepthPair, Unit, files_fingerprint, masked_pair, natural
from hyjax.errors import InputError, did_you_mean
from hyjax.images import read_depth

STEPS = {"millimetres": 0.001, "centimetres": 0.01, "metres": 1.0, "tenths": 0.0001, "tum": 0.0002}
"""What one stored step is in metres, by name: tenths of a millimetre, and TUM's fifths of one, among them."""
PICTURES = (".png", ".jpg", ".jpeg")


class PairFolder:
    """Pairs in natural order of their names (`learn2` before `learn10`).

    Args:
        path: the folder.
        steps: what a stored step is, a key of `STEPS`.

    Raises:
        InputError: no such folder, no pairs in it, a picture without depth or the reverse, or an unknown unit.
    """

    unit: Unit = "metres"

    def __init__(self, path: Path, steps: str = "millimetres") -> None:
        if steps not in STEPS:
            hint = did_you_mean(steps, STEPS)
            raise InputError(f"{path}: depth in unknown unit {steps!r}{hint}; use one of {', '.join(STEPS)}")
        self.name = path.resolve().name
        self._path, self._step = path, STEPS[steps]
        self._pairs = _find(path)
        self._names = list(self._pairs)

    @property
    def fingerprint(self) -> str:
        """See `DepthPairs`."""
        return files_fingerprint(self._path, [file for pair in self._pairs.values() for file in pair])

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, index: int) -> DepthPair:
        """The pair at a position.

        Raises:
            InputError: a file is damaged, sizes differ, or there is no depth at all.
        """
        name = self._names[index]
        colour, depth = self._pairs[name]
        return masked_pair(name, read_colour(colour), read_depth(depth, self._step), self.unit, where=depth)


def _find(path: Path) -> dict[str, tuple[Path, Path]]:
    if not path.is_dir():
        raise InputError(f"{path}: no such folder; give a folder of pictures with depth")
    if (path / "rgb").is_dir() and (path / "depth").is_dir():
        return matched(path, named(path / "rgb", lambda stem: stem), named(path / "depth", lambda stem: stem))
    return matched(path, named(path, ends_in("_rgb")), named(path, ends_in("_depth")))


def ends_in(ending: str) -> Callable[[str], str | None]:
    """Of a file's stem, what stands before `ending`; None if it does not end so."""
    return lambda stem: stem.removesuffix(ending) if stem.endswith(ending) else None


def named(
    folder: Path, name_of: Callable[[str], str | None], suffixes: tuple[str, ...] = PICTURES
) -> dict[str, Path]:
    """Pictures of a folder by the name that `name_of` finds in their stem.

    Raises:
        InputError: two files of the same name.
    """
    found: dict[str, Path] = {}
    for file in sorted(folder.iterdir()):
        name = name_of(file.stem) if file.suffix.lower() in suffixes else None
        if name is None:
            continue
        if name in found:
            raise InputError(f"{file}: there is also {found[name].name}; keep one of the two")
        found[name] = file
    return found


def matched(path: Path, colours: dict[str, Path], depths: dict[str, Path]) -> dict[str, tuple[Path, Path]]:
    """(picture, depth) by name, in natural order.

    Raises:
        InputError: there are none, or one has no partner.
    """
    if not colours and not depths:
        raise InputError(f"{path}: no pairs; looked for NAME_rgb.png + NAME_depth.png, or rgb/NAME + depth/NAME")
    for name in sorted(colours.keys() ^ depths.keys(), key=natural):
        if name in colours:
            raise InputError(f"{colours[name]}: has no depth map of its name; add it or remove the picture")
        raise InputError(f"{depths[name]}: has no picture of its name; add it or remove the depth map")
    return {name: (colours[name], depths[name]) for name in sorted(colours, key=natural)}
