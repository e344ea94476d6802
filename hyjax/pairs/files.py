"""Helpers of the readers of pairs in picture files: matching each picture with its depth map."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from hyjax.data.capture_files import read_colour
from hyjax.pairs.depth_pairs import DepthPair, Unit, masked_pair, natural
from hyjax.util.errors import InputError
from hyjax.util.files import digest

PICTURES = (".png", ".jpg", ".jpeg", ".ppm")
Files = tuple[Path, ...]
Reader = Callable[[Files], tuple[Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"] | None]]
"""Reader of depth and of its validity, None where `masked_pair` finds it alone."""


class FilePairs:
    """Pairs (`DepthPairs`) of picture and depth map, in natural order of their names.

    Args:
        files: by name, a picture, its depth map, and further files that `read` needs.
    """

    def __init__(self, path: Path, unit: Unit, files: Mapping[str, Files], read: Reader) -> None:
        self.name, self.unit = path.resolve().name, unit
        self._path, self._read = path, read
        self._files = {name: files[name] for name in sorted(files, key=natural)}
        self._names = list(self._files)

    @property
    def fingerprint(self) -> str:
        """Fingerprint, see `DepthPairs`; from names and sizes, without reading."""
        files = [file for files in self._files.values() for file in files]
        return digest(f"{file.relative_to(self._path).as_posix()} {file.stat().st_size}" for file in files)

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, index: int) -> DepthPair:
        name = self._names[index]
        color, *rest = self._files[name]
        depth, valid = self._read(tuple(rest))
        return masked_pair(name, read_colour(color), depth, self.unit, where=rest[0], valid=valid)


def named(folder: Path, ending: str = "", suffixes: tuple[str, ...] = PICTURES) -> dict[str, Path]:
    """Files of a folder whose stem ends in `ending`, by the rest of the stem; dangling links do not count."""
    found: dict[str, Path] = {}
    for file in sorted(folder.iterdir()):
        if file.suffix.lower() in suffixes and file.stem.endswith(ending) and file.is_file():
            name = file.stem.removesuffix(ending)
            if name in found:
                raise InputError(f"{file}: there is also {found[name].name}; keep one of the two")
            found[name] = file
    return found


def matched(*kinds: dict[str, Path]) -> dict[str, Files]:
    """Match files of the same name: the first kind are pictures, the others belong to them."""
    names = sorted({name for kind in kinds for name in kind}, key=natural)
    for name in names:
        here = [kind[name] for kind in kinds if name in kind]
        for kind in kinds:
            if name not in kind:
                wanted = "and nothing here is named as partners are"
                if kind:
                    other, file = next(iter(kind.items()))
                    wanted = f"{file.with_name(file.name.replace(other, name, 1))} is not there"
                raise InputError(f"{here[0]}: has no partner, {wanted}; add it or remove this file")
    return {name: tuple(kind[name] for kind in kinds) for name in names}


def folders(path: Path) -> list[Path]:
    """List a folder and all folders in it, at any depth, in order."""
    if not path.is_dir():
        raise InputError(f"{path}: no such folder; give a folder of pictures with depth")
    return sorted(Path(folder) for folder, _, _ in os.walk(path, followlinks=True))
