"""Rasteriser on the host: a mesh as views see it, without a tree, by all cores and without holding up Python.

The alternative to casting a ray through each pixel (`hyjax.geometry.raycast`), equal to it but for pixels whose
centre lies on an edge to within rounding.
"""

import dataclasses
import functools
import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import jax
import numpy as np
from jaxtyping import Float, Int

from hyjax.geometry.camera import Camera
from hyjax.light.gbuffer import GBuffer
from hyjax.util.cores import cores
from hyjax.util.errors import InputError

T = TypeVar("T")
ALIGNMENT = 64
"""Bytes; `jax.device_put` takes over the memory of arrays that are aligned so, where it can."""
MOST_BUFFERS = 8
"""Threads that draw one picture: each has a picture of its own, and all are merged."""
MOST_PIXELS = 1 << 24
"""Most pixels of all these pictures together: 128 MiB. A picture larger than that is drawn by one thread."""
BANDS = 2
"""Bands of rows for each thread, whose surface points are made: rows are not equally full."""
NO_FACES = np.empty((0, 0), np.int32)


@dataclasses.dataclass(frozen=True, eq=False)
class RasterView:
    """View to draw: rays through pixel centres, from one point or parallel.

    Attributes:
        axes: rows are the axes of the view in world coordinates, of any length.
        origin: world metres.
        pieces: homogeneous column, row and w of a point in those axes, by the signs of its first coordinates; see
            `hyjax.geometry.raster_kernels.project`.
        spans: first and last column that belong to each piece in each row.
        norm: length of each pixel's ray, from the origin to where w is 1.
        limit: keys of the distances at which rays begin (see `hyjax.geometry.raster_kernels`), −∞ where none does.
        parallel: whether rays are; they run along the third axis.
    """

    axes: Float[np.ndarray, "3 3"]
    origin: Float[np.ndarray, "3"]
    pieces: Float[np.ndarray, "p 3 3"]
    spans: Int[np.ndarray, "p 2 h"]
    norm: Float[np.ndarray, "h w"]
    limit: Float[np.ndarray, "h w"]
    parallel: bool = False

    def of_moved(self, pose: Float[np.ndarray, "4 4"]) -> "RasterView":
        """The view for a mesh that stands in the world by a rigid pose."""
        turn, shift = pose[:3, :3], pose[:3, 3]
        return dataclasses.replace(self, axes=self.axes @ turn, origin=turn.T @ (self.origin - shift))

    @property
    def arguments(self) -> tuple[Any, ...]:
        """Arguments as kernels take them."""
        return np.ascontiguousarray(np.vstack([self.axes, self.origin]), np.float64), self.pieces, self.parallel


class Rasterizer:
    """A mesh to be drawn.

    Args:
        vertices: world metres; copied, like the triangles.
    """

    def __init__(self, vertices: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "m 3"]) -> None:
        self.vertices = np.array(vertices, np.float64, order="C")
        self.triangles = np.array(triangles, np.int32, order="C").reshape(-1, 3)
        if self.triangles.size and not 0 <= self.triangles.min() <= self.triangles.max() < len(self.vertices):
            raise InputError(
                f"mesh: triangles name vertices {self.triangles.min()} to {self.triangles.max()}; there are 0 to "
                f"{len(self.vertices) - 1}"
            )

    def distances(self, view: RasterView) -> Float[np.ndarray, "h w"]:
        """Distance of the nearest surface along each ray, by one thread; infinite for a miss.

        Where the view's limit is −∞ the distance is, too.
        """
        from hyjax.geometry import raster_kernels  # Numba is slow to load

        points, sides, chosen = self._scratch()
        mask, shape = len(view.pieces) - 1, view.norm.shape
        keys = np.full(shape, -np.inf if view.parallel else 0.0, np.float32)
        raster_kernels.project(self.vertices, *view.arguments, points, sides, 0, len(points))
        count = raster_kernels.select(self.triangles, points, sides, mask, 0, len(chosen), shape, chosen)
        mesh = chosen[:count], self.vertices, self.triangles
        raster_kernels.draw(*mesh, *view.arguments, points, sides, view.spans, view.limit, (keys, NO_FACES))
        raster_kernels.distances(keys, view.norm, view.limit, view.parallel)
        return keys

    def gbuffer(self, camera: Camera, normals: Float[np.ndarray, "n 3"]) -> GBuffer:
        """G-buffer of the mesh in a camera, by all threads."""
        from hyjax.geometry import raster_kernels, surface_kernel

        view, rays = camera_view(camera), camera_rays(camera)
        height, width = view.norm.shape
        points, sides, chosen = self._scratch()
        # Each thread draws some of the triangles into a picture of its own.
        buffers = max(1, min(cores(), MOST_BUFFERS, MOST_PIXELS // (height * width)))
        normals = np.ascontiguousarray(normals, np.float32)
        position, normal, barycentric = (_aligned((height, width, 3), np.float32) for _ in range(3))
        depth, hit = _aligned((height, width), np.float32), _aligned((height, width), np.bool_)
        faces, keys = np.empty((buffers, height, width), np.int32), np.zeros((buffers, height, width), np.float32)

        def project(part: slice) -> None:
            raster_kernels.project(self.vertices, *view.arguments, points, sides, part.start, part.stop)

        def select(part: slice) -> np.ndarray:
            limits = part.start, part.stop
            count = raster_kernels.select(self.triangles, points, sides, 0, *limits, (height, width), chosen)
            return chosen[part.start : part.start + count]

        def draw(buffer: int) -> None:
            own = seen[len(seen) * buffer // buffers : len(seen) * (buffer + 1) // buffers]
            mesh, into = (own, self.vertices, self.triangles), (keys[buffer], faces[buffer])
            raster_kernels.draw(*mesh, *view.arguments, points, sides, view.spans, view.limit, into)

        def finish(part: slice) -> None:
            raster_kernels.merge(keys, faces, part.start, part.stop)
            rows, mesh = (part.start, part.stop), (self.vertices, self.triangles, normals)
            made = position, normal, depth, hit, barycentric
            surface_kernel.surface(*mesh, points, rays, faces[0], rows, *made)

        share_out(project, len(points), cores())
        seen = np.concatenate(share_out(select, len(chosen), cores()))
        share_out(lambda part: draw(part.start), buffers, buffers)
        share_out(finish, height, BANDS * cores())
        face = faces[0].copy()  # what is kept of a picture keeps no more than itself in memory
        return GBuffer(*jax.device_put((position, normal, depth, hit, face, barycentric)))

    def _scratch(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        count = len(self.vertices)
        return np.empty((count, 4)), np.empty(count, np.uint8), np.empty(len(self.triangles), np.int32)


def camera_view(camera: Camera) -> RasterView:
    """View of a camera; distances are depths, along its axis."""
    k = camera.intrinsics
    piece = k.matrix - np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
    norm, limit = constant(k.shape, 1.0), constant(k.shape, np.inf)
    axes, spans = np.linalg.inv(camera.pose[:3, :3]), whole_spans(*k.shape)
    return RasterView(axes, camera.origin, piece[None], spans, norm, limit)


@functools.lru_cache(maxsize=8)
def constant(shape: tuple[int, int], value: float) -> Float[np.ndarray, "h w"]:
    """An array of one value, not to be changed."""
    return np.full(shape, value, np.float32)


def camera_rays(camera: Camera) -> Float[np.ndarray, "4 3"]:
    """World direction of the ray through the first pixel, its change by a column and a row, and the origin."""
    k, turn = camera.intrinsics, camera.pose[:3, :3]
    first = turn @ [(0.5 - k.cx) / k.fx, (0.5 - k.cy) / k.fy, 1.0]
    return np.stack([first, turn[:, 0] / k.fx, turn[:, 1] / k.fy, camera.origin]).astype(np.float64)


def whole_spans(height: int, width: int) -> Int[np.ndarray, "1 2 h"]:
    """Spans of a view of one piece."""
    return np.stack([np.zeros(height, np.int32), np.full(height, width - 1, np.int32)])[None]


def share_out(work: Callable[[slice], T], count: int, parts: int) -> list[T]:
    """Work on parts of a range, shared among all cores.

    Args:
        work: on a part; must let go of Python for cores to work at once.

    Returns:
        Results, in the parts' order.
    """
    edges = np.linspace(0, count, min(parts, max(count, 1)) + 1).astype(int)
    each = [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
    return list(map(work, each) if cores() == 1 else threads().map(work, each))


@functools.lru_cache(maxsize=1)
def threads() -> ThreadPoolExecutor:
    """Threads that draw, one for each core."""
    return ThreadPoolExecutor(cores(), "rasterizer")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=threads.cache_clear)


def _aligned(shape: tuple[int, ...], kind: Any) -> np.ndarray:
    """Array that JAX takes over without a copy, with memory of its own."""
    size = int(np.prod(shape)) * np.dtype(kind).itemsize
    memory = np.empty(size + ALIGNMENT, np.uint8)
    start = -memory.ctypes.data % ALIGNMENT
    return memory[start : start + size].view(kind).reshape(shape)
