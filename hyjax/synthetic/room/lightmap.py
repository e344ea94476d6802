"""Light maps: texels on every chart, their places in the room, and their lookup."""

import numpy as np
from jaxtyping import Bool, Float, Int

from hyjax.geometry.raycast import Hits
from hyjax.synthetic.surface import Surface, rows

MAX_TEXELS = 512
"""Most texels along one side of a chart."""


class Texels:
    """Texels of all charts in one array, chart after chart, each row by row.

    Attributes:
        columns, rows: texels along s and t of each chart.
        start: first texel of each chart.
        chart: chart of each texel.
        pitch: metres between the texels of each chart.
        position, normal: of each texel's centre, in world metres.
    """

    def __init__(self, surface: Surface, scale: float = 1.0) -> None:
        vertices = np.asarray(surface.mesh.vertices)
        size = np.array([_lengths(vertices[n]) for n in surface.nodes])
        count = np.clip(np.ceil(size / (surface.texel * scale)), 1, MAX_TEXELS).astype(np.int64)
        self.columns, self.rows = count.T
        self.pitch = (size / count).max(axis=1)
        self.start = np.concatenate([[0], np.cumsum(self.columns * self.rows)])
        self._shape = np.stack([self.columns, self.rows, self.start[:-1]], axis=1).astype(np.int32)
        self.chart = np.repeat(np.arange(len(count)), self.columns * self.rows)
        local = np.arange(len(self.chart)) - self.start[self.chart]
        self.i, self.j = local % self.columns[self.chart], local // self.columns[self.chart]
        self._surface = surface
        place = self._spread(np.concatenate([surface.mesh.vertices, surface.mesh.vertex_normals], axis=1))
        self.position = place[:, :3].astype(np.float32)
        length = np.linalg.norm(place[:, 3:], axis=1, keepdims=True)
        self.normal = (place[:, 3:] / np.maximum(length, 1e-9)).astype(np.float32)

    def __len__(self) -> int:
        return len(self.chart)

    def _spread(self, values: Float[np.ndarray, "v d"]) -> Float[np.ndarray, "n d"]:
        """Interpolate values at the charts' control nodes to the texel centres."""
        nodes = self._surface.nodes
        shape = np.array([n.shape for n in nodes])[self.chart]
        first = np.concatenate([[0], np.cumsum([n.size for n in nodes])])[self.chart]
        flat = np.concatenate([n.ravel() for n in nodes])
        x = (self.i + 0.5) / self.columns[self.chart] * (shape[:, 1] - 1)
        y = (self.j + 0.5) / self.rows[self.chart] * (shape[:, 0] - 1)
        x0, y0 = x.astype(np.int64), y.astype(np.int64)
        fx, fy = (x - x0)[:, None], (y - y0)[:, None]
        at = first + y0 * shape[:, 1] + x0
        upper = values[flat[at]] * (1 - fx) + values[flat[at + 1]] * fx
        at = at + shape[:, 1]
        lower = values[flat[at]] * (1 - fx) + values[flat[at + 1]] * fx
        return upper * (1 - fy) + lower * fy

    def nearest(self, chart: Int[np.ndarray, "n"], st: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, "n"]:
        """Index of the texel that contains (s, t)."""
        columns, lines, start = rows(self._shape, chart).T
        i = np.clip((st[:, 0] * columns).astype(np.int32), 0, columns - 1)
        j = np.clip((st[:, 1] * lines).astype(np.int32), 0, lines - 1)
        return start + j * columns + i

    def lookup(
        self, values: Float[np.ndarray, "t d"], chart: Int[np.ndarray, "n"], st: Float[np.ndarray, "n 2"]
    ) -> Float[np.ndarray, "n d"]:
        """Texel values interpolated at (s, t)."""
        columns, lines, start = rows(self._shape, chart).T
        x = np.clip(st[:, 0] * columns - 0.5, 0, columns - 1)
        y = np.clip(st[:, 1] * lines - 0.5, 0, lines - 1)
        x0, y0 = x.astype(np.int32), y.astype(np.int32)
        fx, fy = (x - x0).astype(np.float32)[:, None], (y - y0).astype(np.float32)[:, None]
        x1, y1 = np.minimum(x0 + 1, columns - 1), np.minimum(y0 + 1, lines - 1)
        top, bottom = start + y0 * columns, start + y1 * columns
        upper = rows(values, top + x0) * (1 - fx) + rows(values, top + x1) * fx
        lower = rows(values, bottom + x0) * (1 - fx) + rows(values, bottom + x1) * fx
        return upper * (1 - fy) + lower * fy


def _lengths(grid: Float[np.ndarray, "t s 3"]) -> tuple[float, float]:
    """Lengths of the longest of a few rows and columns of a grid of points."""
    rows, columns = grid[[0, len(grid) // 2, -1]], grid[:, [0, grid.shape[1] // 2, -1]]
    along_s = np.linalg.norm(np.diff(rows, axis=1), axis=-1).sum(axis=1).max()
    along_t = np.linalg.norm(np.diff(columns, axis=0), axis=-1).sum(axis=0).max()
    return float(along_s), float(along_t)


def select(hits: Hits, chosen: Bool[np.ndarray, "n"]) -> Hits:
    """Select some of the hits."""
    return Hits(hits.distance[chosen], hits.face[chosen], hits.barycentric[chosen])


def at_hits(corner_values: Float[np.ndarray, "f 3 d"], hits: Hits) -> Float[np.ndarray, "n d"]:
    """Interpolate per-corner values of the faces at hits (all of which must have hit)."""
    corners = rows(corner_values, hits.face)
    weight = hits.barycentric
    return corners[:, 0] * weight[:, :1] + corners[:, 1] * weight[:, 1:2] + corners[:, 2] * weight[:, 2:]
