"""What one grabs in the scene: lamps, windows, and the gizmo of whichever is chosen."""

import threading
from typing import TYPE_CHECKING, Any

import numpy as np
import viser.transforms

from hyjax.color import blackbody, to_display
from hyjax.tour.place import unit, upright
from hyjax.tour.plan import Lamp, Piece, Window
from hyjax.tour.viewer import guarded, quaternion

if TYPE_CHECKING:
    from hyjax.tour.page import Tour

Chosen = tuple[str, int]
SIZES = {"bulb": 0.05, "spot": 0.04, "candle": 0.025, "strip": 0.03}
GIZMO = 0.35  # metres
CHOSEN, GLASS = (255, 140, 0), (120, 180, 255)


class Handles:
    """Shared by all viewers: whoever drags, everybody sees it move."""

    def __init__(self, tour: "Tour") -> None:
        self.tour = tour
        self.chosen: Chosen | None = None
        self._nodes: list[Any] = []
        self._gizmo: Any = None
        self._drawing = threading.RLock()

    def select(self, chosen: Chosen | None) -> None:
        """Choose a lamp, window or piece by kind and number, as `("lamps", 0)`; None for nothing."""
        with self.tour.lock:
            self.chosen = chosen if chosen is not None and self._exists(*chosen) else None
            self.tour.controls.choose(self.chosen)
            self.draw()

    def _exists(self, kind: str, index: int) -> bool:
        return index < len(getattr(self.tour.plan, kind))

    def draw(self) -> None:
        """Draw them all anew."""
        with self._drawing:
            self._draw()

    def _draw(self) -> None:
        scene, plan = self.tour.server.scene, self.tour.plan
        for node in [*self._nodes, *([self._gizmo] if self._gizmo is not None else [])]:
            node.remove()
        self._nodes, self._gizmo = [], None
        for index, lamp in enumerate(plan.lamps):
            color = CHOSEN if self.chosen == ("lamps", index) else _color(lamp)
            node = scene.add_icosphere(f"/lamps/{index}", SIZES[lamp.kind], color=color, position=lamp.position)
            self._add(node, ("lamps", index))
        for index, window in enumerate(plan.windows):
            color = CHOSEN if self.chosen == ("windows", index) else GLASS
            outline = _outline(window, self.tour)
            self._add(scene.add_line_segments(f"/windows/{index}/frame", outline, color, thickness=0.012), None)
            knob = scene.add_icosphere(f"/windows/{index}/knob", 0.05, color=color, position=window.center)
            self._add(knob, ("windows", index))
        if self.chosen is not None and self._exists(*self.chosen):
            self._gizmo = self._grab(*self.chosen)
        for viewer in list(self.tour.viewers.values()):
            viewer.redraw_soon()

    def _add(self, node: Any, chosen: Chosen | None) -> None:
        self._nodes.append(node)
        if chosen is not None:
            node.on_click(guarded(self.tour, lambda _: self.select(chosen)))

    def _grab(self, kind: str, index: int) -> Any:
        thing = getattr(self.tour.plan, kind)[index]
        pose = self._pose(thing)
        turns = not (isinstance(thing, Lamp) and thing.kind in ("bulb", "candle"))
        gizmo = self.tour.server.scene.add_transform_controls(
            "/gizmo",
            GIZMO,
            disable_rotations=not turns,
            depth_test=False,
            wxyz=quaternion(pose),
            position=pose[:3, 3],
        )

        def moved(event: Any) -> None:
            if event.target is not self._gizmo:  # taken away from under somebody's hand
                return
            new = np.eye(4)
            new[:3, :3] = viser.transforms.SO3(np.asarray(event.target.wxyz)).as_matrix()
            new[:3, 3] = event.target.position
            self._move(kind, index, new)
            if event.phase == "end":
                self.draw()
                viewer = self.tour.viewers.get(event.client_id)
                if kind == "lamps" and viewer is not None:
                    self.tour.warn_if_hidden(viewer, index)

        gizmo.on_update(guarded(self.tour, moved))
        return gizmo

    def _pose(self, thing: Lamp | Window | Piece) -> np.ndarray:
        if isinstance(thing, Piece):
            pose = thing.matrix.copy()
            pose[:3, 3] = pose[:3, :3] @ self._pivot(thing) + pose[:3, 3]
            return pose
        pose = np.eye(4)
        forward = np.asarray(thing.direction if isinstance(thing, Lamp) else thing.normal, float)
        pose[:3, :3] = _frame(forward, self.tour.studio.up)
        pose[:3, 3] = thing.position if isinstance(thing, Lamp) else thing.center
        return pose

    def _pivot(self, piece: Piece) -> np.ndarray:
        """A piece turns about the middle of its box."""
        mesh = self.tour.studio.house.piece_mesh(piece)
        return np.zeros(3) if mesh is None else np.asarray(mesh.bounds.mean(axis=0))

    def _move(self, kind: str, index: int, pose: np.ndarray) -> None:
        x, y, z = (float(v) for v in pose[:3, 3])
        forward = tuple(float(v) for v in pose[:3, 2])
        if kind == "lamps":
            self.tour.replace(kind, index, position=(x, y, z), direction=forward)
        elif kind == "windows":
            self.tour.replace(kind, index, center=(x, y, z), normal=forward)
        else:
            pose = pose.copy()
            pose[:3, 3] -= pose[:3, :3] @ self._pivot(self.tour.plan.pieces[index])
            self.tour.replace(kind, index, pose=tuple(float(v) for v in pose.reshape(-1)))


def _frame(forward: np.ndarray, up: np.ndarray) -> np.ndarray:
    """A rotation whose z axis is `forward`, its y axis as upright as can be."""
    z = unit(forward)
    y = upright(z, up)
    return np.stack([np.cross(y, z), y, z], axis=1)


def _outline(window: Window, tour: "Tour") -> np.ndarray:
    x, y, z = _frame(np.asarray(window.normal, float), tour.studio.up).T
    across, high = 0.5 * window.width * x, 0.5 * window.height * y
    centre = np.asarray(window.center) + 0.01 * z
    corners = [centre + s * across + t * high for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return np.stack([np.stack([a, b]) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)])


def _color(lamp: Lamp) -> tuple[int, int, int]:
    color = np.asarray(to_display(blackbody(lamp.kelvin))) * (1.0 if lamp.on else 0.25)
    r, g, b = (int(255 * min(max(float(v), 0.0), 1.0)) for v in color / max(color.max(), 1e-6))
    return r, g, b
