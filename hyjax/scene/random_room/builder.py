"""Collecting a random room's triangles, each with a look of its own."""

import contextlib
import dataclasses
from collections.abc import Iterator

import numpy as np
import trimesh
from jaxtyping import Float, Int

from hyjax.scene.random_room.looks import Looks
from hyjax.scene.room import materials as m
from hyjax.scene.room.surface import DEGENERATE_AREA, WHITE, Builder, Colour

ROLES = {
    m.PAINT: "wall", m.FLOOR: "floor", m.WOOD: "wood", m.FABRIC: "cloth", m.STRIPES: "cloth", m.RUG: "rug",
    m.BOOK: "print", m.CERAMIC: "glazed", m.LACQUER: "lacquer", m.LEAF: "leaf", m.SOIL: "soil", m.PICTURE: "photo",
    m.WEAVE: "cloth", m.PAGES: "paper",
}  # fmt: skip
"""What the built-in room's materials become."""


@dataclasses.dataclass(frozen=True)
class Furnished:
    """A room's triangles.

    Attributes:
        mesh: metres, z up; vertices are split at hard edges.
        look: row of the table of looks, for each face.
        uv: texture coordinates of each face's corners in metres.
        looks: the table.
    """

    mesh: trimesh.Trimesh
    look: Int[np.ndarray, "f"]
    uv: Float[np.ndarray, "f 3 2"]
    looks: Looks


class RoomBuilder(Builder):
    """A `Builder` whose materials are looks, which may scale parts, and which keeps no light maps.

    Attributes:
        looks: where looks are drawn from.
        targets: (point, size) of what is worth a picture, in world metres; kept by who places things.
    """

    def __init__(self, rng: np.random.Generator, looks: Looks) -> None:
        super().__init__(0)
        self.rng = rng
        self.looks = looks
        self.targets: list[tuple[np.ndarray, float]] = []
        self._dressing: dict[tuple[int, Colour], int] | None = None

    @contextlib.contextmanager
    def scaled(self, x: float, y: float, z: float) -> Iterator[None]:
        """Within, local coordinates are stretched."""
        outer = self._place
        self._place = outer @ np.diag([x, y, z, 1.0])
        try:
            yield
        finally:
            self._place = outer

    @contextlib.contextmanager
    def tilted(self, degrees: float, axis: int = 0) -> Iterator[None]:
        """Within, coordinates are turned about the local x axis (or another)."""
        outer = self._place
        a, b = (axis + 1) % 3, (axis + 2) % 3
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        turn = np.eye(4)
        turn[[a, a, b, b], [a, b, a, b]] = c, -s, s, c
        self._place = outer @ turn
        try:
            yield
        finally:
            self._place = outer

    @contextlib.contextmanager
    def dressed(self) -> Iterator[None]:
        """Within, parts name the built-in room's materials; each material and tint gets a look of its own."""
        outer, self._dressing = self._dressing, {}
        try:
            yield
        finally:
            self._dressing = outer

    def draw(self, role: str, tile: float | None = None) -> int:
        """A look for a role, see `Looks.draw`."""
        return self.looks.draw(self.rng, role, tile)

    def _add_triangles(
        self,
        points: Float[np.ndarray, "n 3"],
        index: Int[np.ndarray, "q 4"],
        st: Float[np.ndarray, "q 4 2"],
        uv: Float[np.ndarray, "q 4 2"],
        chart: Int[np.ndarray, "q"],
        material: int,
        tint: Colour,
    ) -> None:
        look = material
        if self._dressing is not None:
            key = (material, tint if tint != WHITE else WHITE)
            if key not in self._dressing:
                self._dressing[key] = self.draw(ROLES[material], 1.0 if material == m.PICTURE else None)
            look = self._dressing[key]
        lists = self._lists
        for corners in ([0, 1, 2], [0, 2, 3]):
            lists["faces"].append(index[:, corners] + self._count)
            lists["uv"].append(uv[:, corners])
            lists["material"].append(np.full(len(index), look))

    def furnished(self) -> Furnished:
        """Everything added so far."""
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
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
        mesh = trimesh.Trimesh(
            points, faces, face_normals=across / twice[:, None], vertex_normals=normals, process=False
        )
        return Furnished(
            mesh,
            np.concatenate(self._lists["material"])[real],
            np.concatenate(self._lists["uv"])[real].astype(np.float32),
            self.looks,
        )
