"""Captures: sequences of posed pictures of one place, and the formats in which they lie on disk."""

import abc
import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from hyjax.data.file_tree import FileTree
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.geometry.depth_map import DepthReading
from hyjax.geometry.depth_sensor import UNKNOWN, DepthSensor
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError
from hyjax.util.files import digest

if TYPE_CHECKING:
    import trimesh

    from hyjax.geometry.scan import PosedDepths, ScanConfig

MARGIN_DEPTH = 0.03
"""Largest share of a picture's side in a margin that shows nothing, as where a lens was undone."""


@checked_arguments
@dataclasses.dataclass(frozen=True)
class Frame:
    """A posed picture, with depth if the device measured it.

    Attributes:
        name: short and unique within the capture; output files are named after it.
        image: display-encoded (sRGB) colours in [0, 1].
        camera: intrinsics of `image` and camera-to-world pose.
        time: seconds since the capture's start.
        depth: distance along the camera's axis in metres, 0 where there is no reading; None without a sensor.
        depth_intrinsics: of `depth`, where its size or lens differs from the image's; None if they are the same.
        confidence: of each reading of `depth`, in [0, 1]; None where the device does not tell.
        exposure: seconds; None where it is not told.
    """

    name: str
    image: Float[np.ndarray, "h w 3"]
    camera: Camera
    time: float
    depth: Float[np.ndarray, "dh dw"] | None = None
    depth_intrinsics: Intrinsics | None = None
    confidence: Float[np.ndarray, "dh dw"] | None = None
    exposure: float | None = None

    def __post_init__(self) -> None:
        if not self.name or set(self.name) & set("/\\\0"):
            raise InputError(f"frame {self.name!r}: its name becomes that of files; give one without folders")
        if self.image.ndim != 3 or self.image.shape[:2] != self.camera.intrinsics.shape:
            k = self.camera.intrinsics
            raise InputError(
                f"frame {self.name}: picture is {self.image.shape[1]}x{self.image.shape[0]} but its intrinsics "
                f"are for {k.width}x{k.height}; give the intrinsics of this picture size"
            )

    @property
    def depth_camera(self) -> Camera:
        """The camera that `depth` belongs to."""
        if self.depth_intrinsics is None:
            return self.camera
        return Camera(self.depth_intrinsics, self.camera.pose)


class Capture(abc.ABC):
    """Sequence of frames of one place, with its mesh, lamps and gravity as far as they are known.

    Frames are read when asked for, so that long captures fit in memory. A format sets `name` and `up` and has
    `fingerprint`, `__len__` and `__getitem__`; the rest has defaults.

    Attributes:
        name: short; messages and output files use it.
        up: unit vector against gravity in world coordinates.
        anchors: known places for lights by name, in world coordinates and metres: `window_0`, … with `center`,
            `normal` (into the room), `width` and `height`; `lamp_0`, … with `position`.
        mesh_file: of the mesh that the device made; None without one.
        laser_folder: of the place's laser scans (see `experiments.laser_scans`); None without any.
        sensor: that measured the depth.
        metric: whether its lengths are metres, as far as is known.
        depth_in_units: whether depth is in the unit of the poses, as it is where it was computed from pictures.
        times_known: whether the times of its frames were recorded; otherwise their order gives them.
        faults: what is damaged and was left out, a line each; `open_capture` warns of them, or refuses them.
        remarks: what else is worth telling, a line each.
        format: name of the layout that it was read from; empty where it was made in memory.
        strict: whether damaged frames are refused rather than left out.
    """

    name: str
    up: Float[np.ndarray, "3"]
    sensor: DepthSensor = UNKNOWN
    metric: bool = True
    depth_in_units: bool = False
    times_known: bool = True
    faults: Sequence[str] = ()
    remarks: Sequence[str] = ()
    format: str = ""
    strict: bool = False
    anchors: Mapping[str, Mapping[str, Any]] = MappingProxyType({})
    mesh_file: Path | None = None
    laser_folder: Path | None = None

    @property
    @abc.abstractmethod
    def fingerprint(self) -> str:
        """A key that changes whenever the content does; meshes made from a capture are cached under it."""

    @abc.abstractmethod
    def __len__(self) -> int: ...

    @abc.abstractmethod
    def __getitem__(self, index: int) -> Frame:
        """The frame at a position; IndexError beyond the end."""

    def __iter__(self) -> Iterator[Frame]:
        return (self[index] for index in range(len(self)))

    @property
    def picture_source(self) -> "Capture":
        """Capture with the same pictures, maybe by other cameras: itself, but for one that only moves them."""
        return self

    def picture(self, index: int) -> Frame:
        """The frame at a position without its depth, which is not read where it is kept apart."""
        return dataclasses.replace(self[index], depth=None, depth_intrinsics=None, confidence=None)

    def camera(self, index: int) -> Camera:
        """Camera of the frame at a position; formats that need no picture for it read none."""
        return self[index].camera

    @property
    def depth_count(self) -> int:
        """Number of depth maps, which may be more than the frames: see `depth_reading`."""
        for index in range(len(self)):
            try:
                return len(self) if self[index].depth is not None else 0
            except InputError:  # a damaged frame; the next one tells as well
                continue
        return 0

    def depth_position(self, index: int) -> float:
        """Position of a frame's time among the depth maps: between two of them it is a fraction."""
        return float(index)

    def depth_reading(self, index: int) -> DepthReading:
        """A depth map by its position among `depth_count`, as it was measured; no picture is read for it.

        Raises:
            InputError: it cannot be read, or there is none.
        """
        frame = self[index]
        if frame.depth is None:
            raise InputError(f"{self.name}: frame {frame.name} has no depth map")
        return DepthReading(frame.depth, frame.depth_camera, frame.confidence)

    def mesh(self) -> "trimesh.Trimesh | None":
        """The mesh that the device made, in world coordinates; None without one.

        Raises:
            InputError: its file cannot be used.
        """
        if self.mesh_file is None:
            return None
        from hyjax.geometry.mesh import load_mesh

        # Reconstructions made on a device have a triangle without area here and there.
        return load_mesh(self.mesh_file, repair=True)

    @property
    def has_mesh(self) -> bool:
        """Whether the device made a mesh, which is not read for it."""
        return self.mesh_file is not None

    def reference(self) -> "trimesh.Trimesh | None":
        """The true surface in world coordinates; None where it is not known, as of any real place."""
        return None

    @property
    def has_reference(self) -> bool:
        """Whether the true surface is known."""
        return self.reference() is not None

    def scan_input(self) -> "tuple[PosedDepths, ScanConfig | None]":
        """Depth maps and scanner for `hyjax.geometry.scan.simulate_scan`: the capture's own, the default one."""
        return self if self.depth_count in (0, len(self)) else _DepthMaps(self), None


class _DepthMaps:
    """The depth maps of a capture that has not one of each frame."""

    def __init__(self, capture: Capture) -> None:
        self._capture = capture

    def __len__(self) -> int:
        return self._capture.depth_count

    def __getitem__(self, index: int) -> DepthReading:
        return self._capture.depth_reading(index)


@dataclasses.dataclass(frozen=True)
class CaptureFormat:
    """A way to store a capture in a folder or an archive.

    Attributes:
        name: in help texts and messages.
        recognise: whether files have this format, by their names alone (or a few bytes).
        open: opens such files; raises `InputError` if they cannot be used.
        signs: names of files by which a person recognises the format.
    """

    name: str
    recognise: Callable[[FileTree], bool]
    open: Callable[[FileTree], Capture]
    signs: str


DESCRIPTION = ("name", "up", "sensor", "metric", "depth_in_units", "times_known", "format", "strict")
"""Attributes that hold of all frames and of some."""


class DerivedCapture(Capture):
    """Capture derived from another one; a subclass overrides the parts that differ, at least `fingerprint`.

    One whose frames differ by more than cameras and depth overrides `picture`, too.
    """

    def __init__(self, source: Capture) -> None:
        self.source = source
        for name in (*DESCRIPTION, "anchors", "faults", "remarks", "mesh_file", "laser_folder"):
            setattr(self, name, getattr(source, name))

    def __len__(self) -> int:
        return len(self.source)

    def __getitem__(self, index: int) -> Frame:
        return self.source[index]

    def picture(self, index: int) -> Frame:
        return dataclasses.replace(self.source.picture(index), camera=self.camera(index))

    def camera(self, index: int) -> Camera:
        return self.source.camera(index)

    @property
    def depth_count(self) -> int:
        return self.source.depth_count

    def depth_position(self, index: int) -> float:
        return self.source.depth_position(index)

    def depth_reading(self, index: int) -> DepthReading:
        return self.source.depth_reading(index)

    def mesh(self) -> "trimesh.Trimesh | None":
        return self.source.mesh()

    @property
    def has_mesh(self) -> bool:
        return self.source.has_mesh


class ChosenFrames(Capture):
    """Selected frames of a capture, as a capture of their own that depends on no other frame."""

    def __init__(self, capture: Capture, indices: Sequence[int]) -> None:
        for name in DESCRIPTION:
            setattr(self, name, getattr(capture, name))
        self._capture, self.indices = capture, list(indices)

    @property
    def fingerprint(self) -> str:
        return digest([self._capture.fingerprint, *map(str, self.indices)])

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, index: int) -> Frame:
        return self._capture[self.indices[index]]

    def picture(self, index: int) -> Frame:
        return self._capture.picture(self.indices[index])

    def camera(self, index: int) -> Camera:
        return self._capture.camera(self.indices[index])
