"""Paints views of a plan, and remembers what a change leaves as it was.

What costs time hangs together in a chain: surface → shadow maps → what each light throws on each pixel → diffusion.
Brightness and colour of a light change only the last link; a light that moves changes its own channel alone; a
piece of furniture that moves is cast anew by itself, and its shadow maps join those of the room by their minimum.
"""

import dataclasses
import functools
import json
from collections.abc import Callable, Generator, Hashable
from pathlib import Path
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from jaxtyping import Array

from hyjax.color import to_display, to_linear
from hyjax.data.capture import Capture, Frame
from hyjax.data.frames import fit
from hyjax.data.light_file import parse_lights
from hyjax.data.light_setups import survey_capture
from hyjax.gbuffer import GBuffer
from hyjax.guide.choose import RGB, FrameGuide
from hyjax.scene.camera import Camera
from hyjax.scene.raycast import Hits
from hyjax.scene.shadow_caster import cast_shadow_maps
from hyjax.shading import colored, shade_each
from hyjax.shadow import ShadowMap, visibility
from hyjax.tour.furniture import Part, nearest
from hyjax.tour.house import House, Room
from hyjax.tour.kept import Kept
from hyjax.tour.lighting import flicker, lights_file, setup_of
from hyjax.tour.painting import AMOUNTS, Painting, Seen, View, amount_key, bytes_of, relight_layers, shown_in
from hyjax.tour.place import facing, place_lamp
from hyjax.tour.plan import LampKind, Plan, Window
from hyjax.tuning.latency import StageClock

DRAFT = 0.25
"""Resolution of shadow maps while something is being dragged, relative to that of `hyjax relight`."""
MAPS_MIB, LAYERS_MIB, FRAMES_MIB = 512, 192, 128
ALBEDO = 0.6  # of the mesh in the 3-D view, whose colours nobody knows
AFTERNOON, BEARING = 16.0, 240.0
LOOKS = (*AMOUNTS, "temperature", "color", "name")


class Unwanted(Exception):
    """Nobody waits for this picture any more."""


class Studio:
    """A capture, its surface, and everything that was made of them lately.

    Attributes:
        house: the surface, and what a plan makes of it.

    Args:
        capture: frames with poses.
        mesh: the surface, in the capture's world coordinates.
        guide: what makes the guide of a frame.
        size: (height, width) to work at; None as captured.
        folder: where mesh files that were brought in lie.
    """

    def __init__(
        self,
        capture: Capture,
        mesh: trimesh.Trimesh,
        *,
        guide: FrameGuide = RGB,
        size: tuple[int, int] | None = None,
        folder: Path = Path(),
    ) -> None:
        self.capture, self.guide = capture, guide
        self.up = np.asarray(capture.up, float)
        self.house = House(mesh, self.up, folder)
        a, b, c = mesh.extents
        self.surface = 2.0 * float(a * b + b * c + c * a)
        self._size = size
        self._frames, self._maps, self._layers = Kept(FRAMES_MIB), Kept(MAPS_MIB), Kept(LAYERS_MIB)
        self._cameras: dict[int, Camera] = {}

    # ---- what there is ----

    def first_plan(self) -> Plan:
        """A sunny afternoon, with the capture's own windows or one beside what the cameras look at."""
        anchors: dict[str, Any] = getattr(self.capture, "anchors", {})
        windows = tuple(
            Window(tuple(a["center"]), tuple(a["normal"]), float(a["width"]), float(a["height"]))
            for name, a in sorted(anchors.items())
            if name.startswith("window")
        )
        if not windows:
            stage = survey_capture(self.house.caster, self.capture)
            windows = (
                Window(tuple(stage.window.tolist()), tuple(stage.inward.tolist()), stage.width, stage.height),
            )
        return Plan(hour=AFTERNOON, windows=windows, north=facing(windows[0], BEARING, self.up)).check()

    def frame(self, index: int) -> Frame:
        """A frame at the size that is worked at; not its pixels on the device."""
        return self._frames(("frame", index), lambda: fit(self.capture[index], self._size))

    def camera(self, index: int) -> Camera:
        return self.frame(index).camera

    def captured_camera(self, index: int) -> Camera:
        """Of a frame as it was captured; its picture is read for it only once."""
        if index not in self._cameras:
            self._cameras[index] = self.capture[index].camera
        return self._cameras[index]

    # ---- painting ----

    def paint(
        self,
        plan: Plan,
        view: View,
        *,
        draft: bool = False,
        seconds: float = 0.0,
        unwanted: Callable[[], bool] = lambda: False,
    ) -> Painting:
        """Paint a view.

        Args:
            plan: what is set up.
            view: what is looked at.
            draft: whether coarse shadow maps will do for lights that have just moved.
            seconds: time that has passed, for what flickers.
            unwanted: asked before each view of a shadow map that must be cast; true gives up.

        Raises:
            InputError: the plan makes no sense.
            Unwanted: it was given up. What has been cast so far is kept.
        """
        clock = StageClock()
        flames = {k: flicker(seconds, k) for k, lamp in enumerate(plan.lamps) if lamp.kind == "candle"}
        content = lights_file(plan, self.up, self.surface, flames if seconds else None)
        entries, lux = content["lights"], content["reference_lux"]
        frame = self.frame(view.frame)
        with clock("guide"):
            seen = self._frames(("seen", view.frame), lambda: jax.block_until_ready(self._see(frame)))
        with clock("surface"):
            room = self.house.arranged(plan)
            gbuffer = jax.block_until_ready(self._gbuffer(view.frame, frame, room))
        with clock("light"):
            layers = [self._layer(entry, view.frame, gbuffer, room, draft, unwanted) for entry in entries]
            jax.block_until_ready(layers)
        relit = relight_layers(clock, entries, lux, layers, seen, gbuffer, view.schedule)
        with clock("show"):
            picture = bytes_of(shown_in(view, relit, seen, gbuffer))
            photo = self._frames(("photo", view.frame), lambda: bytes_of(frame.image))
        times = {stage: 1e3 * values[-1] for stage, values in clock.seconds.items()}
        coarse = draft and not all(self._is_fine(entry, view.frame, room) for entry in entries)
        return Painting(picture, photo, np.asarray(relit.image), frame, times, coarse)

    def warm_up(self, plan: Plan, view: View) -> Generator[None]:
        """Compile what visitors are likely to ask for, a little each step: lamps, the moon, the mesh."""
        lamps = tuple(place_lamp(kind, self.camera(view.frame).origin, self.up) for kind in get_args(LampKind))
        changes: list[dict[str, Any]] = [{"lamps": (lamp,)} for lamp in lamps]
        for change in [{}, *changes, {"weather": "full moon"}, {"lamps": lamps}]:
            for draft in (True, False):
                self.paint(dataclasses.replace(plan, **change), view, draft=draft)
                yield
        self.lit_mesh(plan)

    def lit_mesh(self, plan: Plan) -> trimesh.Trimesh:
        """The surface as the plan arranges it, its vertices coloured by the light that falls on them."""
        mesh, room = self.house.arranged_mesh(plan), self.house.arranged(plan)
        entries, setup = setup_of(plan, self.up, self.surface)
        vertices, normals = (jnp.asarray(x, jnp.float32)[None] for x in (mesh.vertices, mesh.vertex_normals))
        everywhere = jnp.ones(vertices.shape[:2])
        seen = GBuffer(vertices, normals, everywhere, everywhere > 0)
        layers = [
            self._light(entry, seen, room, "fine" if self._has_maps(entry, room) else "draft") for entry in entries
        ]
        amounts = [float(entry[amount_key(entry)]) for entry in entries]
        shades = [amount * lux * lit for amount, (lux, lit) in zip(amounts, layers, strict=True)]
        light = colored(jnp.stack(shades, axis=-1), setup.lights) / setup.reference_lux
        mesh.visual.vertex_colors = bytes_of(to_display(ALBEDO * light))[0]  # type: ignore[union-attr]
        return mesh

    # ---- inside ----

    def _see(self, frame: Frame) -> Seen:
        display = jnp.asarray(frame.image)
        return Seen(to_linear(display), self.guide.features(display))

    def _gbuffer(self, index: int, frame: Frame, room: Room) -> GBuffer:
        def part_of(part: Part, key: Hashable) -> GBuffer:
            return self._frames(("g-buffer", index, key), lambda: part.gbuffer(frame.camera))

        return nearest([part_of(part, key) for part, key in zip(room.parts, room.keys, strict=True)])

    def _layer(
        self,
        entry: dict[str, Any],
        index: int,
        gbuffer: GBuffer,
        room: Room,
        draft: bool,
        unwanted: Callable[[], bool],
    ) -> tuple[Array, Array]:
        """Lux of one light for an amount of 1, and what shadows leave of it."""
        quality = "draft" if draft and not self._is_fine(entry, index, room) else "fine"
        key = quality, _geometry(entry), index, room.keys
        return self._layers(key, lambda: self._light(entry, gbuffer, room, quality, unwanted))

    def _is_fine(self, entry: dict[str, Any], index: int, room: Room) -> bool:
        """Whether a light in a frame needs nothing cast any more."""
        return ("fine", _geometry(entry), index, room.keys) in self._layers or self._has_maps(entry, room)

    def _has_maps(self, entry: dict[str, Any], room: Room) -> bool:
        """Whether a light's fine shadow maps are there."""
        if entry["kind"] == "ambient":
            return True
        return all((_geometry(entry), key, "fine") in self._maps for key in room.keys)

    def _light(
        self,
        entry: dict[str, Any],
        gbuffer: GBuffer,
        room: Room,
        quality: str,
        unwanted: Callable[[], bool] = lambda: False,
    ) -> tuple[Array, Array]:
        unit = {k: v for k, v in entry.items() if k not in LOOKS} | {amount_key(entry): 1.0}
        light = parse_lights({"lights": [unit]}, self.up, "tour").lights[0]
        scale = DRAFT if quality == "draft" else 1.0

        def shadows(part: Part, key: Hashable) -> ShadowMap | None:
            patient: Any = Patient(part, unwanted)
            return self._maps(
                (_geometry(entry), key, quality), lambda: cast_shadow_maps(patient, [light], scale)[0]
            )

        maps = [shadows(part, key) for part, key in zip(room.parts, room.keys, strict=True)]
        return shade_each(gbuffer, [light])[..., 0], visibility(gbuffer, light, _together(maps))


@dataclasses.dataclass(frozen=True, eq=False)
class Patient:
    """Casts rays at a part of the room as long as somebody waits for them."""

    part: Part
    unwanted: Callable[[], bool]

    @property
    def mesh(self) -> trimesh.Trimesh:
        return self.part.mesh

    def cast(self, *rays: Any) -> Hits:
        if self.unwanted():
            raise Unwanted
        return self.part.cast(*rays)


def _together(maps: list[ShadowMap | None]) -> ShadowMap | None:
    """The shadow map of several parts of a room: whichever is nearer to the light."""
    first, *others = maps
    if first is None:
        return None
    depth = functools.reduce(jnp.minimum, [m.depth for m in others if m is not None], first.depth)
    return dataclasses.replace(first, depth=depth)


def _geometry(entry: dict[str, Any]) -> str:
    return json.dumps({k: v for k, v in entry.items() if k not in LOOKS}, sort_keys=True)
