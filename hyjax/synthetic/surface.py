"""Surface of a room: triangles with their material and their place in the light maps, and its builder.

Everything is made of *charts*: grids of vertices with s along the columns and t along the rows, ds × dt pointing
outwards. A chart is what a light map is stored for, so each corner of a triangle carries three coordinates: the
vertex, (s, t) in [0, 1]² of its chart, and (u, v) in metres of its material's texture.
"""

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

Color = tuple[float, float, float]
WHITE: Color = (1.0, 1.0, 1.0)

# Below this, a triangle's area (m²) is rounding error of a collapsed quad, such as those at a pole.
DEGENERATE_AREA = 1e-9


@dataclasses.dataclass(frozen=True)
class Grid:
    """Grid of a chart before it has vertices of its own.

    Attributes:
        index: rows of the part's points.
        uv: texture coordinates of the nodes in metres.
        st: chart coordinates of the nodes; evenly spaced if None.
        keep: quads that exist; all if None (a wall has a hole for its window, and one light map all the same).
    """

    index: Int[np.ndarray, "t s"]
    uv: Float[np.ndarray, "t s 2"]
    st: Float[np.ndarray, "t s 2"] | None = None
    keep: Bool[np.ndarray, "t-1 s-1"] | None = None


@dataclasses.dataclass(frozen=True)
class Surface:
    """Surface of a room: all its triangles.

    Attributes:
        mesh: world coordinates in metres.
        chart: chart of each face.
        material: row of the material table of each face.
        tint: linear colour of each face that multiplies its texture.
        st: chart coordinates of each face's corners.
        uv: texture coordinates of each face's corners in metres.
        nodes: the vertex indices of each chart's control grid, evenly spaced in (s, t).
        texel: wanted light-map resolution of each chart along s and t in metres.
    """

    mesh: trimesh.Trimesh
    chart: Int[np.ndarray, "f"]
    material: Int[np.ndarray, "f"]
    tint: Float[np.ndarray, "f 3"]
    st: Float[np.ndarray, "f 3 2"]
    uv: Float[np.ndarray, "f 3 2"]
    nodes: list[Int[np.ndarray, "t s"]]
    texel: Float[np.ndarray, "c 2"]


_QUAD = ((slice(0, -1), slice(0, -1)), (slice(0, -1), slice(1, None)),
         (slice(1, None), slice(1, None)), (slice(1, None), slice(0, -1)))  # fmt: skip


def even_st(shape: tuple[int, int]) -> Float[np.ndarray, "t s 2"]:
    """Chart coordinates of an evenly spaced grid."""
    t, s = np.meshgrid(np.linspace(0, 1, shape[0]), np.linspace(0, 1, shape[1]), indexing="ij")
    return np.stack([s, t], axis=-1)


def rows(values: np.ndarray, index: Int[np.ndarray, "n"]) -> np.ndarray:
    """Rows `values[index]` for indices in range: `take` copies whole rows, which is faster."""
    return values.take(index, axis=0, mode="clip")


def weld(grids: Sequence[Float[np.ndarray, "t s 3"]]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Merge equal points of several grids, so that normals are smooth across their seams."""
    points = np.concatenate([g.reshape(-1, 3) for g in grids])
    _, first, inverse = np.unique(np.round(points, 6), axis=0, return_index=True, return_inverse=True)
    ends = np.cumsum([g.shape[0] * g.shape[1] for g in grids])[:-1]
    parts = np.split(inverse.reshape(-1), ends)
    return points[first], [p.reshape(g.shape[:2]) for p, g in zip(parts, grids)]


class Quads(NamedTuple):
    """Quads of a part: corners as rows of its points, their (s, t) and (u, v); and each quad's chart."""

    points: Int[np.ndarray, "q 4"]
    st: Float[np.ndarray, "q 4 2"]
    uv: Float[np.ndarray, "q 4 2"]
    chart: Int[np.ndarray, "q"]


class Builder:
    """Builder of a surface from parts. Furniture is modelled in its own axes inside `with builder.placed(...)`."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.anchors: dict[str, dict[str, object]] = {}
        self._place = np.eye(4)
        self._count = 0
        self._charts = 0
        self._lists: dict[str, list] = {
            k: [] for k in ("points", "faces", "chart", "material", "tint", "st", "uv", "nodes", "texel")
        }

    def placed(
        self, x: float, y: float, z: float = 0.0, turn: float = 0.0
    ) -> contextlib.AbstractContextManager[None]:
        """Context of local coordinates, turned by `turn` degrees about z and moved to (x, y, z)."""
        c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        return self.transformed(np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1]]))

    @contextlib.contextmanager
    def transformed(self, transform: Float[np.ndarray, "4 4"]) -> Iterator[None]:
        """Context of local coordinates, which `transform` maps to the outer ones."""
        outer = self._place
        self._place = outer @ transform
        try:
            yield
        finally:
            self._place = outer

    def world(self, point: Sequence[float]) -> list[float]:
        """World coordinates of a local point, as plain numbers."""
        return [float(x) for x in self._place[:3, :3] @ np.asarray(point) + self._place[:3, 3]]

    def add(
        self,
        points: Float[np.ndarray, "n 3"],
        grids: Sequence[Grid],
        material: int,
        tint: Color = WHITE,
        texel: float | tuple[float, float] = 0.025,
    ) -> None:
        """Add a part: shared points, and the charts between them."""
        for grid in grids:
            st = even_st(grid.index.shape) if grid.st is None else grid.st
            chosen = np.ones(st[:-1, :-1, 0].shape, bool) if grid.keep is None else grid.keep
            corners = [np.stack([a[q][chosen] for q in _QUAD], axis=1) for a in (grid.index, st, grid.uv)]
            chart = np.full(len(corners[0]), self._charts)
            quads = Quads(corners[0], corners[1], corners[2], chart)
            self._add_triangles(points, quads, material, tint)
            control = grid.index if grid.st is None else grid.index[:: len(st) - 1, :: st.shape[1] - 1]
            self._lists["nodes"].append(control + self._count)
            self._lists["texel"].append(texel if isinstance(texel, tuple) else (texel, texel))
            self._charts += 1
        self._add_points(points)

    def add_quads(
        self,
        corners: Float[np.ndarray, "q 4 3"],
        uv: Float[np.ndarray, "q 4 2"],
        material: int,
        tint: Color = WHITE,
        texel: float = 0.025,
    ) -> None:
        """Add flat quads, each a chart with vertices of its own; one whose last two corners agree is a triangle."""
        index = np.arange(4 * len(corners)).reshape(-1, 4)
        index[:, 3] = np.where((corners[:, 2] == corners[:, 3]).all(axis=1), index[:, 2], index[:, 3])
        st = np.broadcast_to(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), uv.shape)
        chart = self._charts + np.arange(len(corners))
        points = corners.reshape(-1, 3)
        self._add_triangles(points, Quads(index, st, uv, chart), material, tint)
        self._lists["nodes"] += list((index[:, [0, 1, 3, 2]] + self._count).reshape(-1, 2, 2))
        # Chamfers are too narrow to show more than how the light changes along them.
        narrow = np.linalg.norm(corners[:, 2] - corners[:, 1], axis=1) < 0.012
        self._lists["texel"] += [(t, t) for t in np.where(narrow, 3 * texel, texel)]
        self._charts += len(corners)
        self._add_points(points)

    def _add_points(self, points: Float[np.ndarray, "n 3"]) -> None:
        self._lists["points"].append(points @ self._place[:3, :3].T + self._place[:3, 3])
        self._count += len(points)

    def _add_triangles(self, points: Float[np.ndarray, "n 3"], quads: Quads, material: int, tint: Color) -> None:
        face, st, uv = (np.concatenate([a[:, [0, 1, 2]], a[:, [0, 2, 3]]]) for a in quads[:3])
        edge = points[face]
        area = np.linalg.norm(np.cross(edge[:, 1] - edge[:, 0], edge[:, 2] - edge[:, 0]), axis=1) / 2
        real = area > DEGENERATE_AREA
        n = int(real.sum())
        for name, values in (
            ("faces", face[real] + self._count), ("st", st[real]), ("uv", uv[real]),
            ("chart", np.concatenate([quads.chart, quads.chart])[real]), ("material", np.full(n, material)),
            ("tint", np.broadcast_to(tint, (n, 3))),
        ):  # fmt: skip
            self._lists[name].append(values)

    def finish(self) -> Surface:
        """Surface of everything added so far, without vertices that no face uses."""
        lists = self._lists
        faces = np.concatenate(lists["faces"])
        nodes = [n.ravel() for n in lists["nodes"]]
        used = np.unique(np.concatenate([faces.ravel(), *nodes]))
        renamed = np.zeros(self._count, dtype=np.int64)
        renamed[used] = np.arange(len(used))
        mesh = trimesh.Trimesh(np.concatenate(lists["points"])[used], renamed[faces], process=False)
        return Surface(
            mesh=mesh,
            chart=np.concatenate(lists["chart"]),
            material=np.concatenate(lists["material"]),
            tint=np.concatenate(lists["tint"]).astype(np.float32),
            st=np.concatenate(lists["st"]).astype(np.float32),
            uv=np.concatenate(lists["uv"]).astype(np.float32),
            nodes=[renamed[n] for n in lists["nodes"]],
            texel=np.array(lists["texel"]),
        )
