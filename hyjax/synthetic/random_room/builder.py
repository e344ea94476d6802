"""Builder of a random room's triangles, each with a look of its own."""

import contextlib
from collections.abc import Iterator

import numpy as np
import trimesh
from jaxtyping import Bool, Float

from hyjax.synthetic.random_room.looks import Looks
from hyjax.synthetic.room import materials as m
from hyjax.synthetic.surface import DEGENERATE_AREA, Builder, Color, Quads, Surface
from hyjax.util.vectors import SHORTEST_LENGTH, unit

ROLES = {
    m.PAINT: "wall", m.FLOOR: "floor", m.WOOD: "wood", m.FABRIC: "cloth", m.STRIPES: "cloth", m.RUG: "rug",
    m.BOOK: "print", m.CERAMIC: "glazed", m.LACQUER: "lacquer", m.LEAF: "leaf", m.SOIL: "soil", m.PICTURE: "photo",
    m.WEAVE: "cloth", m.PAGES: "paper",
}  # fmt: skip
"""Roles of looks that replace the built-in room's materials, by material."""


class RoomBuilder(Builder):
    """Builder with looks as materials, which may also scale parts.

    Attributes:
        targets: (point, size) of objects worth a picture, in world metres; the layout adds them.
    """

    def __init__(self, rng: np.random.Generator, looks: Looks) -> None:
        super().__init__(0)
        self.rng = rng
        self.looks = looks
        self.targets: list[tuple[np.ndarray, float]] = []
        self._dressing: dict[tuple[int, Color], int] | None = None

    def scaled(self, x: float, y: float, z: float) -> contextlib.AbstractContextManager[None]:
        """Context with stretched local coordinates."""
        return self.transformed(np.diag([x, y, z, 1.0]))

    def tilted(self, degrees: float) -> contextlib.AbstractContextManager[None]:
        """Context with coordinates turned about the local x axis."""
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        turn = np.eye(4)
        turn[1:3, 1:3] = [[c, -s], [s, c]]
        return self.transformed(turn)

    @contextlib.contextmanager
    def dressed(self) -> Iterator[None]:
        """Context for parts in the built-in room's materials; each material and tint gets a look of its own."""
        outer, self._dressing = self._dressing, {}
        try:
            yield
        finally:
            self._dressing = outer

    def draw(self, role: str, tile: float | None = None) -> int:
        """Draw a look for a role, see `Looks.draw`."""
        return self.looks.draw(self.rng, role, tile)

    def _add_triangles(self, points: Float[np.ndarray, "n 3"], quads: Quads, material: int, tint: Color) -> None:
        look = material
        if self._dressing is not None:
            key = (material, tint)
            if key not in self._dressing:
                self._dressing[key] = self.draw(ROLES[material], 1.0 if material == m.PICTURE else None)
            look = self._dressing[key]
        lists = self._lists
        for corners in ([0, 1, 2], [0, 2, 3]):
            lists["faces"].append(quads.points[:, corners] + self._count)
            lists["uv"].append(quads.uv[:, corners])
            lists["material"].append(np.full(len(quads.points), look))
            lists["chart"].append(quads.chart)
        lists["st"].append(quads.st)

    def finish(self) -> Surface:
        """Surface of everything added so far with its charts for light maps; a look stands for a material."""
        mesh, real = self._mesh()
        lists = self._lists
        halves = [quads[:, corners] for quads in lists["st"] for corners in ([0, 1, 2], [0, 2, 3])]
        return Surface(
            mesh=mesh,
            chart=np.concatenate(lists["chart"])[real],
            material=np.concatenate(lists["material"])[real],
            tint=np.ones((len(mesh.faces), 3), np.float32),
            st=np.concatenate(halves)[real].astype(np.float32),
            uv=np.concatenate(lists["uv"])[real].astype(np.float32),
            nodes=lists["nodes"],
            texel=np.array(lists["texel"]),
        )

    def _mesh(self) -> tuple[trimesh.Trimesh, Bool[np.ndarray, "f"]]:
        """Mesh, and the indices of its triangles among the added ones."""
        points = np.concatenate(self._lists["points"])
        faces = np.concatenate(self._lists["faces"])
        corner = points[faces]
        across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        twice = np.linalg.norm(across, axis=1)
        real = twice > 2 * DEGENERATE_AREA
        faces, across, twice = faces[real], across[real], twice[real]
        # Smooth charts share their vertices, hard edges do not: a sum over faces weighted by area is all it takes.
        weights = np.repeat(across, 3, axis=0)
        normals = np.stack([np.bincount(faces.ravel(), weights[:, k], len(points)) for k in range(3)], axis=1)
        normals = unit(normals, SHORTEST_LENGTH)
        mesh = trimesh.Trimesh(
            points, faces, face_normals=across / twice[:, None], vertex_normals=normals, process=False
        )
        return mesh, real
