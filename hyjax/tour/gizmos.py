"""Gizmos in the scene: markers of lamps and windows to click on, and the handle that drags the selected thing."""

import threading
from collections.abc import Mapping
from typing import Any

import numpy as np
import viser
import viser.transforms
from jaxtyping import Float

from hyjax.light.color import blackbody, to_display
from hyjax.tour.events import change_handler
from hyjax.tour.placement import upright
from hyjax.tour.plan import Lamp, Piece, Window
from hyjax.tour.screen import quaternion
from hyjax.tour.session import Selection, Session
from hyjax.tour.viewer import Viewer
from hyjax.util.vectors import unit

SIZES = {"bulb": 0.05, "spot": 0.04, "candle": 0.025, "strip": 0.03}
GIZMO = 0.35  # metres
SELECTED, GLASS = (255, 140, 0), (120, 180, 255)


class Gizmos:
    """Markers and handle in the scene that all viewers share.

    Args:
        session: the plan that they show and change.
        scene: of the server.
        viewers: by the number of their browser.
    """

    def __init__(self, session: Session, scene: viser.SceneApi, viewers: Mapping[int, Viewer]) -> None:
        self.session, self._scene, self._viewers = session, scene, viewers
        self._nodes: list[Any] = []
        self._handle: Any = None
        self._drawing = threading.RLock()

    def draw(self) -> None:
        """Draw them all anew."""
        with self._drawing:
            self._draw()

    def _draw(self) -> None:
        scene, plan, selected = self._scene, self.session.plan, self.session.selected
        for node in [*self._nodes, *([self._handle] if self._handle is not None else [])]:
            node.remove()
        self._nodes, self._handle = [], None
        for index, lamp in enumerate(plan.lamps):
            color = SELECTED if selected == ("lamps", index) else _color(lamp)
            marker = scene.add_icosphere(f"/lamps/{index}", SIZES[lamp.kind], color=color, position=lamp.position)
            self._add_marker(marker, ("lamps", index))
        for index, window in enumerate(plan.windows):
            color = SELECTED if selected == ("windows", index) else GLASS
            outline = _outline(window, self.session.renderer.up)
            name = f"/windows/{index}"
            self._nodes.append(scene.add_line_segments(f"{name}/frame", outline, color, thickness=0.012))
            knob = scene.add_icosphere(f"{name}/knob", 0.05, color=color, position=window.center)
            self._add_marker(knob, ("windows", index))
        if selected is not None and self.session.exists(*selected):
            self._handle = self._add_handle(*selected)
        for viewer in list(self._viewers.values()):
            viewer.redraw_soon()

    def _add_marker(self, node: Any, selection: Selection) -> None:
        self._nodes.append(node)
        node.on_click(change_handler(self._viewers, lambda _: self.session.select(selection)))

    def _add_handle(self, kind: str, index: int) -> Any:
        thing = getattr(self.session.plan, kind)[index]
        pose = self._pose(thing)
        turns = not (isinstance(thing, Lamp) and thing.kind in ("bulb", "candle"))
        handle = self._scene.add_transform_controls(
            "/gizmo",
            GIZMO,
            disable_rotations=not turns,
            depth_test=False,
            wxyz=quaternion(pose),
            position=pose[:3, 3],
        )

        def moved(event: Any) -> None:
            if event.target is not self._handle:  # removed while it is dragged
                return
            new = np.eye(4)
            new[:3, :3] = viser.transforms.SO3(np.asarray(event.target.wxyz)).as_matrix()
            new[:3, 3] = event.target.position
            self._move(kind, index, new)
            if event.phase == "end":
                self.draw()
                viewer = self._viewers.get(event.client_id)
                if kind == "lamps" and viewer is not None:
                    self._warn_if_enclosed(viewer, index)

        handle.on_update(change_handler(self._viewers, moved))
        return handle

    def _warn_if_enclosed(self, viewer: Viewer, index: int) -> None:
        lamps = self.session.plan.lamps
        if index < len(lamps) and self.session.renderer.scene.encloses(self.session.plan, lamps[index].position):
            where = "This lamp is inside a wall or a thing, or outside the room: its light hardly gets out."
            viewer.notices.notify("Is it meant there?", where, color="yellow")

    def _pose(self, thing: Lamp | Window | Piece) -> Float[np.ndarray, "4 4"]:
        if isinstance(thing, Piece):
            pose = thing.matrix.copy()
            pose[:3, 3] = pose[:3, :3] @ self._pivot(thing) + pose[:3, 3]
            return pose
        pose = np.eye(4)
        forward = np.asarray(thing.direction if isinstance(thing, Lamp) else thing.normal, float)
        pose[:3, :3] = _frame(forward, self.session.renderer.up)
        pose[:3, 3] = thing.position if isinstance(thing, Lamp) else thing.center
        return pose

    def _pivot(self, piece: Piece) -> Float[np.ndarray, "3"]:
        """Centre of a piece's bounding box, about which it turns."""
        mesh = self.session.renderer.scene.piece_mesh(piece)
        return np.zeros(3) if mesh is None else np.asarray(mesh.bounds.mean(axis=0))

    def _move(self, kind: str, index: int, pose: Float[np.ndarray, "4 4"]) -> None:
        x, y, z = (float(v) for v in pose[:3, 3])
        forward = tuple(float(v) for v in pose[:3, 2])
        if kind == "lamps":
            self.session.replace(kind, index, position=(x, y, z), direction=forward)
        elif kind == "windows":
            self.session.replace(kind, index, center=(x, y, z), normal=forward)
        else:
            pose = pose.copy()
            pose[:3, 3] -= pose[:3, :3] @ self._pivot(self.session.plan.pieces[index])
            self.session.replace(kind, index, pose=tuple(float(v) for v in pose.reshape(-1)))


def _frame(forward: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """A rotation whose z axis is `forward`, its y axis as upright as can be."""
    z = unit(forward)
    y = upright(z, up)
    return np.stack([np.cross(y, z), y, z], axis=1)


def _outline(window: Window, up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 2 3"]:
    x, y, z = _frame(np.asarray(window.normal, float), up).T
    across, high = 0.5 * window.width * x, 0.5 * window.height * y
    centre = np.asarray(window.center) + 0.01 * z
    corners = [centre + s * across + t * high for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return np.stack([np.stack([a, b]) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)])


def _color(lamp: Lamp) -> tuple[int, int, int]:
    color = np.asarray(to_display(blackbody(lamp.kelvin))) * (1.0 if lamp.on else 0.25)
    r, g, b = (int(255 * min(max(float(v), 0.0), 1.0)) for v in color / max(color.max(), 1e-6))
    return r, g, b
