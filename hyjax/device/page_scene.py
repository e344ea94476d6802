"""Scene of an exported page: its arrays in one packed file, and its description for the scripts."""

import dataclasses
import gzip
from collections.abc import Mapping
from typing import Any

import numpy as np

from hyjax.device.light_records import KIND_NUMBERS, light_records
from hyjax.device.renderer import bar_vectors, emitter_vectors
from hyjax.device.scene_arrays import SceneArrays
from hyjax.light.kinds import LIGHT_KINDS, kind_name
from hyjax.light.kinds.file_keys import REQUIRED, FileKey, plain
from hyjax.light.setup import LightSetup
from hyjax.scene.scene import Scene

ALIGNMENT = 16
"""Bytes that each array's place in the file is a multiple of."""
GZIP_LEVEL = 5


@dataclasses.dataclass(frozen=True)
class PackedArrays:
    """Arrays in one file.

    Attributes:
        content: of the file: gzip of the arrays one after the other.
        entries: name, dtype, shape, offset and whether it holds differences, of each.
        bytes: of the file once it is unpacked.
    """

    content: bytes
    entries: list[dict[str, Any]]
    bytes: int


def pack_arrays(arrays: Mapping[str, np.ndarray], differences: tuple[str, ...] = ()) -> PackedArrays:
    """Pack arrays into one file.

    Args:
        arrays: by name.
        differences: names of those that are stored as differences from one number to the next, modulo 2³²:
            triangles that are near each other share vertices that are, too.
    """
    parts, entries, offset = [], [], 0
    for name, values in arrays.items():
        stored = np.ascontiguousarray(values)
        if name in differences:
            flat = stored.reshape(-1).astype(np.uint32)
            stored = np.concatenate([flat[:1], flat[1:] - flat[:-1]])
        data = stored.astype(stored.dtype.newbyteorder("<")).tobytes()
        entries.append(
            {
                "name": name,
                "dtype": stored.dtype.name,
                "shape": list(values.shape),
                "offset": offset,
                "differences": name in differences,
            }
        )
        data += bytes(-len(data) % ALIGNMENT)
        parts.append(data)
        offset += len(data)
    return PackedArrays(gzip.compress(b"".join(parts), GZIP_LEVEL, mtime=0), entries, offset)


def pack_scene(arrays: SceneArrays) -> PackedArrays:
    """Content of the program's buffers, as small as it can be kept without loss."""
    uploads = arrays.uploads()
    # Vertices in the order in which the tree's triangles come: what is near in space is near in the file.
    used, first, place = np.unique(uploads["occluders"], return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(used), np.uint32)
    rank[order] = np.arange(len(used), dtype=np.uint32)
    rest = np.setdiff1d(np.arange(len(uploads["vertices"])), used)
    uploads["vertices"] = uploads["vertices"][np.concatenate([used[order], rest])]
    uploads["occluders"] = rank[place.reshape(uploads["occluders"].shape)]
    if len(uploads["hits"]) and uploads["hits"].max() < 1 << 16:
        uploads["hits"] = uploads["hits"].astype(np.uint16)
    uploads["fields"] = uploads["fields"][..., :3]  # the fourth numbers are unused
    return pack_arrays(uploads, ("occluders", "faces"))


def describe_scene(scene: Scene, setup: LightSetup, arrays: SceneArrays) -> dict[str, Any]:
    """Description of a scene for the scripts that light it: the mirror of `hyjax.device.renderer`."""
    light_records(setup.lights, scene.occluders.mesh)
    emitters, photo = scene.photo_light.emitters(setup), scene.photo_light
    panes: Any = []
    bars: Any = []
    lamps: Any = []
    means: Any = []
    if emitters is not None:
        emitter_vectors(emitters)
        panes, lamps, means = emitters.panes, emitters.lamps, emitters.pane_means
        bars = [[plain(pair) for pair in bar_vectors(emitters.bars, k)] for k in range(len(panes))]
    bounds = np.asarray(scene.occluders.mesh.bounds)
    return {
        "up": plain(scene.capture.up),
        "bounds": [plain(corner) for corner in bounds],
        "slack": scene.slack,
        "mean": plain(arrays.mean),
        "filled_share": photo.estimate.light.filled_share,
        "sources": list(photo.estimate.names) if arrays.counts.sources else [],
        "panes": [[plain(vector) for vector in pane] for pane in np.asarray(panes)],
        "pane_bars": bars,
        "lamps": [plain(lamp) for lamp in np.asarray(lamps)],
        "pane_means": [plain(mean) for mean in np.asarray(means)],
        "counts": dataclasses.asdict(arrays.counts),
    }


def setup_content(setup: LightSetup) -> dict[str, Any]:
    """A set-up as the content of a lights file; see `hyjax.data.light_file`."""
    lights = [{"kind": kind_name(light)} | light.to_entry() for light in setup.lights]
    existing = {name: list(factors) for name, factors in setup.existing.items()}
    return {"reference_lux": plain(setup.reference_lux), "lights": lights, "existing": existing}


def light_keys() -> dict[str, list[dict[str, Any]]]:
    """Keys of each kind of light that there is a shader for, so that scripts check a lights file as Python does."""
    return {name: [_key(key) for key in cls.KEYS] for name, cls in LIGHT_KINDS.items() if cls in KIND_NUMBERS}


def _key(key: FileKey) -> dict[str, Any]:
    nested = isinstance(key.form, tuple)
    return {
        "name": key.name,
        "form": "mapping" if nested else key.form,
        "keys": [_key(part) for part in key.form] if isinstance(key.form, tuple) else [],
        "required": key.default is REQUIRED,
        "default": None if key.default is REQUIRED else key.default,
        "least": key.least,
        "most": key.most,
        "positive": key.positive,
    }
