"""Tasks of a tour's visitors: what a message asks for, beside pictures, and its answer."""

from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from hyjax.device.page_scene import setup_content
from hyjax.geometry.camera import Camera
from hyjax.light.setup import LightSetup
from hyjax.tour.daylight import describe_daylight
from hyjax.tour.editable_scene import SurfaceHit
from hyjax.tour.messages import Message
from hyjax.tour.placement import as_point, draw_window, place_window
from hyjax.tour.plan import Piece
from hyjax.tour.renderer import Renderer
from hyjax.util.errors import InputError
from hyjax.util.vectors import unit

DRAWN_RAYS = 7
"""Rays a side through a rectangle that is drawn."""


def camera_of(renderer: Renderer, message: Message) -> Camera:
    """Camera that a visitor looks through."""
    frame = renderer.camera(min(message.view.frame, len(renderer.capture) - 1))
    return frame if message.view.camera is None else message.view.free_camera(frame.intrinsics)


def daylight(renderer: Renderer, message: Message) -> dict[str, Any]:
    """Light from outside as entries of a lights file, with its numbers (see `Outside`), and all that in words."""
    outside = renderer.lighting.outside(message.plan)
    return {
        "lights": setup_content(LightSetup(outside.lights))["lights"],
        "lumen": outside.lumen,
        "kelvin": outside.kelvin,
        "lux": outside.lux,
        "said": describe_daylight(message.plan, renderer.up),
    }


def surface(renderer: Renderer, message: Message) -> dict[str, Any]:
    """Point and normal of the surface at a pixel; None where there is none."""
    hit = _hit(renderer, message)
    return {"point": None} if hit is None else {"point": as_point(hit.point), "normal": as_point(hit.normal)}


def furniture(renderer: Renderer, message: Message) -> dict[str, Any]:
    """Piece of furniture at a pixel: its number in the plan, or a new one."""
    scene, plan, hit = renderer.scene, message.plan, _hit(renderer, message)
    if hit is None:
        raise InputError("there is no surface here; click on a thing")
    if hit.piece is not None:
        return {"piece": hit.piece}
    x, y, z = (round(float(v), 4) for v in hit.origin)
    piece = Piece((x, y, z))
    mesh = scene.piece_mesh(piece)
    if mesh is None:
        raise InputError("The scan has no piece of its own here: it is a part of the room, or was not caught")
    if (number := scene.overlapping_piece(plan, piece)) is not None:
        return {"piece": number}
    piece = replace(piece, centre=as_point(mesh.bounds.mean(axis=0).round(4)))
    replace(plan, pieces=(*plan.pieces, piece)).check()
    return {"new": piece}


def window(renderer: Renderer, message: Message) -> dict[str, Any]:
    """Window for a rectangle that was drawn on a wall, or for a click: two opposite corners, or one place."""
    scene, plan, camera = renderer.scene, message.plan, camera_of(renderer, message)
    places = np.array(message.places).reshape(-1, 2)
    if len(places) == 1:
        hit = _hit(renderer, message)
        if hit is None:
            raise InputError("there is no surface here; click on a wall")
        made = place_window(hit.point, hit.normal, renderer.up)
    elif len(places) == 2:
        across, down = (np.linspace(side.min(), side.max(), DRAWN_RAYS) for side in places.T)
        grid = np.stack(np.meshgrid(across, down), axis=-1)
        origin, rays = _rays(camera, grid.reshape(-1, 2))
        points, normals = scene.visible_surface(plan, origin, rays)
        corners = rays.reshape(DRAWN_RAYS, DRAWN_RAYS, 3)[[0, 0, -1, -1], [0, -1, -1, 0]]
        made = draw_window(origin, corners, points, normals, renderer.up)
    else:
        raise InputError(f"window: needs one place or two, got {len(places)}")
    replace(plan, windows=(*plan.windows, made)).check()
    return {"window": made}


TASKS: dict[str, Callable[[Renderer, Message], dict[str, Any]]] = {
    "daylight": daylight,
    "surface": surface,
    "furniture": furniture,
    "window": window,
}


def answer(renderer: Renderer, message: Message) -> str:
    """Answer to a message whose task is one of `TASKS`."""
    return reply(message, TASKS[message.task](renderer, message))


def reply(message: Message, made: dict[str, Any]) -> str:
    """Answer as it is sent."""
    return msgspec.json.encode({"number": message.number, **made}).decode()


def _hit(renderer: Renderer, message: Message) -> SurfaceHit | None:
    """Surface at the first of a message's places."""
    if not message.places:
        raise InputError(f"{message.task}: needs a place")
    origin, rays = _rays(camera_of(renderer, message), np.array(message.places[:1]))
    return renderer.scene.pick(message.plan, origin, rays[0])


def _rays(
    camera: Camera, pixels: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "n 3"]]:
    """Start and unit directions of rays through places in the picture, in pixels from its corner."""
    local = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(camera.intrinsics.matrix).T
    return camera.origin, unit(local @ camera.pose[:3, :3].T)
