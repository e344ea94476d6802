"""Paints views of a plan, and remembers what a change leaves as it was.

What costs time hangs together in a chain: surface → shadow maps → what each light throws on each pixel → diffusion.
Brightness and colour of a light change only the last link; a light that moves changes its own channel alone; a
piece of furniture that moves is cast anew by itself, and its shadow maps join those of the room by their minimum.
"""

import dataclasses
import functools
import json
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from jaxtyping import Array, ArrayLike, Float, UInt8

from hyjax.color import blackbody, to_display, to_linear
from hyjax.data.capture import Capture, Frame
from hyjax.data.frames import fit
from hyjax.data.light_file import parse_lights
from hyjax.data.light_setups import survey_capture
from hyjax.diffusion import conductance
from hyjax.errors import InputError
from hyjax.gbuffer import GBuffer
from hyjax.guide.choose import RGB, FrameGuide
from hyjax.lights import PointLight
from hyjax.pipeline import Relit, relight_stages
from hyjax.scene.camera import Camera
from hyjax.scene.mesh import load_mesh, submesh
from hyjax.scene.raycast import RayCaster
from hyjax.scene.shadow_caster import cast_shadow_maps, fibonacci_sphere
from hyjax.schedule import Schedule
from hyjax.shading import colored, shade_each
from hyjax.shadow import ShadowMap, visibility
from hyjax.tour.furniture import Part, cast_parts, nearest, piece_at
from hyjax.tour.plan import Piece, Plan, Window, facing, flicker, lights_file, setup_of
from hyjax.tuning.latency import StageClock

Shown = Literal["relit", "photo", "raw filter", "refined filter", "visibility", "conductances", "holes"]
T = TypeVar("T")

DRAFT = 0.25
"""Resolution of shadow maps while something is being dragged, relative to that of `hyjax relight`."""
CHANNELS = 4
"""Lights are rounded up to a multiple of this: a lamp more rarely means compiling anew."""
MAPS_MIB, LAYERS_MIB, FRAMES_MIB = 512, 192, 128
MOST_PARTS = 64
BESIDE = (0.0, 0.01, 0.025, 0.05)  # tangents of angles
ALBEDO = 0.6  # of the mesh in the 3-D view, whose colours nobody knows
AFTERNOON, BEARING = 16.0, 240.0
AMOUNTS = ("power", "illuminance")
LOOKS = (*AMOUNTS, "temperature", "color", "name")


@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """What somebody looks at: a frame of the capture, a stage of its picture, and how the light is refined."""

    frame: int
    shown: Shown
    schedule: Schedule


@dataclasses.dataclass(frozen=True)
class Painting:
    """A view, painted.

    Attributes:
        picture: display-encoded, what the view shows.
        photo: display-encoded, the frame as it was taken.
        linear: the relit picture in linear light.
        frame: whose it is.
        milliseconds: by stage.
        draft: whether shadows are still coarse.
    """

    picture: UInt8[np.ndarray, "h w 3"]
    photo: UInt8[np.ndarray, "h w 3"]
    linear: Float[np.ndarray, "h w 3"]
    frame: Frame
    milliseconds: dict[str, float]
    draft: bool


@dataclasses.dataclass(frozen=True)
class Touch:
    """Where a ray met the room.

    Attributes:
        point: metres, world axes.
        normal: unit, on the side that the ray came from.
        piece: number of the plan's piece that was met; None for the rest of the room.
        origin: where that point was when the room was scanned.
    """

    point: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]
    piece: int | None
    origin: Float[np.ndarray, "3"]


def mebibytes(made: object) -> float:
    """What arrays, or the picture of a frame, take in memory."""
    pixels = made.image if isinstance(made, Frame) else made
    return sum(getattr(leaf, "nbytes", 0) for leaf in jax.tree.leaves(pixels)) / 2**20


class Kept:
    """What was made last, up to a sum of weights: of what it takes in memory, unless `weigh` says otherwise."""

    def __init__(self, most: float, weigh: Callable[[object], float] = mebibytes) -> None:
        self._most, self._weigh = most, weigh
        self._made: OrderedDict[Hashable, Any] = OrderedDict()
        self._size = 0.0
        self._lock = threading.Lock()

    def __contains__(self, key: Hashable) -> bool:
        return key in self._made

    def __call__(self, key: Hashable, make: Callable[[], T]) -> T:
        with self._lock:
            if key in self._made:
                self._made.move_to_end(key)
                return self._made[key]
        made = make()
        with self._lock:
            if key not in self._made:
                self._made[key] = made
                self._size += self._weigh(made)
            while self._size > self._most and len(self._made) > 1:
                _, old = self._made.popitem(last=False)
                self._size -= self._weigh(old)
        return made


@dataclasses.dataclass(frozen=True, eq=False)
class Room:
    """The parts of the room as a plan has them; `keys` name part and pose, `pieces` are the plan's numbers."""

    parts: tuple[Part, ...]
    keys: tuple[Hashable, ...]
    pieces: tuple[int | None, ...]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Seen:
    """A frame on the device."""

    linear: Float[Array, "h w 3"]
    guide: Float[Array, "h w f"]


class Studio:
    """A capture, its surface, and everything that was made of them lately.

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
        self.capture, self.mesh, self.guide = capture, mesh, guide
        self.up = np.asarray(capture.up, float)
        a, b, c = mesh.extents
        self.surface = 2.0 * float(a * b + b * c + c * a)
        self._size, self._folder = size, folder
        self._caster = RayCaster(mesh)
        self._frames, self._maps, self._layers = Kept(FRAMES_MIB), Kept(MAPS_MIB), Kept(LAYERS_MIB)
        self._cameras: dict[int, Camera] = {}
        self._parts = Kept(MOST_PARTS, weigh=lambda _: 1.0)

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
            stage = survey_capture(self._caster, self.capture)
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

    def touch(self, plan: Plan, origin: Sequence[float], direction: Sequence[float]) -> Touch | None:
        """The first surface on a ray, or beside one that goes through a hole of the scan; None if there is none."""
        ray = np.asarray(direction, float) / np.linalg.norm(direction)
        across = np.cross(ray, np.eye(3)[np.argmin(np.abs(ray))])
        across /= np.linalg.norm(across)
        for tangent in BESIDE:
            turns = np.linspace(0.0, 2.0 * np.pi, 8 if tangent else 1, endpoint=False)
            for turn in turns:
                aside = np.cos(turn) * across + np.sin(turn) * np.cross(ray, across)
                if (touch := self._touch(plan, origin, ray + tangent * aside)) is not None:
                    return touch
        return None

    def _touch(self, plan: Plan, origin: Sequence[float], direction: Float[np.ndarray, "3"]) -> Touch | None:
        room, start = self._room(plan), np.asarray(origin, float)
        distances, normals, numbers = cast_parts(room.parts, start[None], direction[None])
        if not np.isfinite(distances[0]):
            return None
        pose, point, normal = room.parts[numbers[0]].pose, start + distances[0] * direction, normals[0]
        towards = -normal if normal @ direction > 0 else normal
        return Touch(point, towards, room.pieces[numbers[0]], (point - pose[:3, 3]) @ pose[:3, :3])

    def hidden(self, plan: Plan, point: Sequence[float]) -> bool:
        """Whether a point is inside something, or outside the room: most surfaces around show it their backs."""
        directions = fibonacci_sphere(64)
        origins = np.broadcast_to(np.asarray(point, float), directions.shape)
        distances, normals, _ = cast_parts(self._room(plan).parts, origins, directions)
        back = np.einsum("nk,nk->n", normals, directions) > 0
        return bool(back.sum() > 0.5 * np.isfinite(distances).sum())

    def piece_mesh(self, piece: Piece) -> trimesh.Trimesh | None:
        """The surface of a piece where it was scanned; None if there is nothing at its seed but the room itself.

        Raises:
            InputError: its file cannot be read.
        """
        if piece.file:
            return self._parts(("file", piece.file), lambda: self._brought(piece.file))
        faces = self._faces(piece)
        if faces is None:
            return None
        return self._parts(("mesh", piece.seed), lambda: submesh(self.mesh, faces))

    # ---- painting ----

    def paint(self, plan: Plan, view: View, *, draft: bool = False, seconds: float = 0.0) -> Painting:
        """Paint a view.

        Args:
            plan: what is set up.
            view: what is looked at.
            draft: whether coarse shadow maps will do for lights that have just moved.
            seconds: time that has passed, for what flickers.

        Raises:
            InputError: the plan makes no sense.
        """
        clock = StageClock()
        flames = {k: flicker(seconds, k) for k, lamp in enumerate(plan.lamps) if lamp.kind == "candle"}
        content = lights_file(plan, self.up, self.surface, flames if seconds else None)
        entries, lux = content["lights"], content["reference_lux"]
        frame = self.frame(view.frame)
        with clock("guide"):
            seen = self._frames(("seen", view.frame), lambda: jax.block_until_ready(self._see(frame)))
        with clock("surface"):
            room = self._room(plan)
            gbuffer = jax.block_until_ready(self._gbuffer(view.frame, frame, room))
        with clock("light"):
            layers = [self._layer(entry, view.frame, gbuffer, room, draft) for entry in entries]
            jax.block_until_ready(layers)
        relit = _relight(clock, entries, lux, layers, seen, gbuffer, view.schedule)
        with clock("show"):
            picture = bytes_of(_shown(view, relit, seen, gbuffer))
            photo = self._frames(("photo", view.frame), lambda: bytes_of(frame.image))
        times = {stage: 1e3 * values[-1] for stage, values in clock.seconds.items()}
        coarse = draft and not all(self._is_fine(entry, room) for entry in entries)
        return Painting(picture, photo, np.asarray(relit.image), frame, times, coarse)

    def lit_mesh(self, plan: Plan) -> trimesh.Trimesh:
        """The surface as the plan arranges it, its vertices coloured by the light that falls on them."""
        mesh, room = self.arranged_mesh(plan), self._room(plan)
        entries, setup = setup_of(plan, self.up, self.surface)
        vertices, normals = (jnp.asarray(x, jnp.float32)[None] for x in (mesh.vertices, mesh.vertex_normals))
        everywhere = jnp.ones(vertices.shape[:2])
        seen = GBuffer(vertices, normals, everywhere, everywhere > 0)
        layers = [self._light(entry, seen, room, self._quality(entry, room, draft=True)) for entry in entries]
        amounts = [float(entry[_amount_key(entry)]) for entry in entries]
        shades = [amount * lux * lit for amount, (lux, lit) in zip(amounts, layers, strict=True)]
        light = colored(jnp.stack(shades, axis=-1), setup.lights) / setup.reference_lux
        mesh.visual.vertex_colors = bytes_of(to_display(ALBEDO * light))[0]  # type: ignore[union-attr]
        return mesh

    def arranged_mesh(self, plan: Plan) -> trimesh.Trimesh:
        """The whole surface as the plan arranges it."""
        moved = []
        for part in self._room(plan).parts:
            copy = part.caster.mesh.copy(include_cache=True)  # scanned normals, which shade it
            copy.apply_transform(part.pose)
            moved.append(copy)
        whole: trimesh.Trimesh = trimesh.util.concatenate(moved)  # type: ignore[assignment]
        return whole

    # ---- inside ----

    def _see(self, frame: Frame) -> Seen:
        display = jnp.asarray(frame.image)
        return Seen(to_linear(display), self.guide.features(display))

    def _brought(self, file: str) -> trimesh.Trimesh:
        mesh = load_mesh(self._folder / file, repair=True)
        if Path(file).suffix == ".glb":  # whose y axis is up, always
            mesh.apply_transform(trimesh.geometry.align_vectors([0.0, 1.0, 0.0], self.up))
        return mesh

    def same_piece(self, plan: Plan, piece: Piece) -> int | None:
        """The number of the plan's piece that some of a new piece's surface belongs to."""
        faces = self._faces(piece)
        for number, other in enumerate(plan.pieces):
            mask = None if other.file else self._faces(other)
            if faces is not None and mask is not None and bool((faces & mask).any()):
                return number
        return None

    def _faces(self, piece: Piece) -> np.ndarray | None:
        return self._parts(("faces", piece.seed), lambda: piece_at(self.mesh, np.asarray(piece.seed), self.up))

    def _room(self, plan: Plan) -> Room:
        still = np.eye(4)
        scanned = tuple(sorted({piece.seed for piece in plan.pieces if not piece.file}))
        masks = [mask for seed in scanned if (mask := self._faces(Piece(seed))) is not None]
        if masks:
            rest = self._parts(
                ("rest", scanned), lambda: RayCaster(submesh(self.mesh, ~np.logical_or.reduce(masks)))
            )
        else:
            rest, scanned = self._caster, ()
        parts = [Part(rest, still, self.mesh)]
        keys: list[Hashable] = [("rest", scanned)]
        pieces: list[int | None] = [None]
        for number, piece in enumerate(plan.pieces):
            if piece.removed or (mesh := self.piece_mesh(piece)) is None:
                continue
            name = ("piece", piece.seed, piece.file)
            caster = self._parts(("caster", name), functools.partial(RayCaster, mesh))
            parts.append(Part(caster, piece.matrix, self.mesh))
            keys.append((name, piece.pose))
            pieces.append(number)
        return Room(tuple(parts), tuple(keys), tuple(pieces))

    def _gbuffer(self, index: int, frame: Frame, room: Room) -> GBuffer:
        def part_of(part: Part, key: Hashable) -> GBuffer:
            return self._frames(("g-buffer", index, key), lambda: part.gbuffer(frame.camera))

        return nearest([part_of(part, key) for part, key in zip(room.parts, room.keys, strict=True)])

    def _layer(
        self, entry: dict[str, Any], index: int, gbuffer: GBuffer, room: Room, draft: bool
    ) -> tuple[Array, Array]:
        """Lux of one light for an amount of 1, and what shadows leave of it."""
        quality = self._quality(entry, room, draft)
        key = quality, _geometry(entry), index, room.keys
        return self._layers(key, lambda: self._light(entry, gbuffer, room, quality))

    def _quality(self, entry: dict[str, Any], room: Room, draft: bool) -> str:
        return "draft" if draft and not self._is_fine(entry, room) else "fine"

    def _is_fine(self, entry: dict[str, Any], room: Room) -> bool:
        """Whether a light's shadow maps are there already."""
        if entry["kind"] == "ambient":
            return True
        return all((_geometry(entry), key, "fine") in self._maps for key in room.keys)

    def _light(self, entry: dict[str, Any], gbuffer: GBuffer, room: Room, quality: str) -> tuple[Array, Array]:
        unit = {k: v for k, v in entry.items() if k not in LOOKS} | {_amount_key(entry): 1.0}
        light = parse_lights({"lights": [unit]}, self.up, "tour").lights[0]
        scale = DRAFT if quality == "draft" else 1.0

        def shadows(part: Part, key: Hashable) -> ShadowMap | None:
            name = (_geometry(entry), key, quality)
            return self._maps(name, lambda: cast_shadow_maps(part, [light], scale)[0])  # type: ignore[arg-type]

        maps = [shadows(part, key) for part, key in zip(room.parts, room.keys, strict=True)]
        return shade_each(gbuffer, [light])[..., 0], visibility(gbuffer, light, _together(maps))


def _together(maps: list[ShadowMap | None]) -> ShadowMap | None:
    """The shadow map of several parts of a room: whichever is nearer to the light."""
    first, *others = maps
    if first is None:
        return None
    depth = functools.reduce(jnp.minimum, [m.depth for m in others if m is not None], first.depth)
    return dataclasses.replace(first, depth=depth)


def _geometry(entry: dict[str, Any]) -> str:
    return json.dumps({k: v for k, v in entry.items() if k not in LOOKS}, sort_keys=True)


def _amount_key(entry: dict[str, Any]) -> str:
    return next(key for key in AMOUNTS if key in entry)


@functools.lru_cache(maxsize=4096)
def _color(kelvin: float) -> np.ndarray:
    return np.asarray(blackbody(kelvin), np.float32)


def _relight(
    clock: StageClock,
    entries: list[dict[str, Any]],
    reference_lux: float,
    layers: list[tuple[Array, Array]],
    seen: Seen,
    gbuffer: GBuffer,
    schedule: Schedule,
) -> Relit:
    count = -(-len(entries) // CHANNELS) * CHANNELS
    amounts = np.zeros(count, np.float32)
    colors = np.ones((count, 3), np.float32)
    for k, entry in enumerate(entries):
        amounts[k], colors[k] = entry[_amount_key(entry)], _color(round(entry["temperature"], 0))
    each, visible = _stack(tuple(layers), amounts, count)
    # All that is left of a light once it has been shaded is its colour.
    nowhere, nothing = jnp.zeros(3), jnp.zeros(())
    lights = [PointLight(nowhere, nothing, color) for color in colors]  # type: ignore[arg-type]
    stages = relight_stages(
        seen.linear,
        gbuffer,
        lights,
        seen.guide,
        schedule,
        shading=each,
        visibility=visible,
        reference_lux=np.float32(reference_lux),
    )
    return clock.follow(stages)


@functools.partial(jax.jit, static_argnames="count")
def _stack(layers: tuple[tuple[Array, Array], ...], amounts: Array, count: int) -> tuple[Array, Array]:
    missing = count - len(layers)
    blank = jnp.zeros_like(layers[0][0])
    each = jnp.stack([lux for lux, _ in layers] + [blank] * missing, axis=-1) * amounts
    return each, jnp.stack([lit for _, lit in layers] + [blank + 1.0] * missing, axis=-1)


def _shown(view: View, relit: Relit, seen: Seen, gbuffer: GBuffer) -> Array:
    if view.shown == "photo":
        return to_display(seen.linear)
    if view.shown == "raw filter":
        # With its shadows, as an unrefined renderer shows it.
        return to_display(relit.unrefined / jnp.maximum(seen.linear, 1e-3))
    if view.shown == "refined filter":
        return to_display(relit.relight_filter)
    if view.shown == "visibility":
        return relit.visibility
    if view.shown == "conductances":
        kappa = view.schedule.levels[-1].kappa
        vertical, horizontal = conductance(seen.guide, kappa, norm=view.schedule.norm)
        grey = jnp.minimum(
            jnp.pad(vertical, ((0, 1), (0, 0)), constant_values=1.0),
            jnp.pad(horizontal, ((0, 0), (0, 1)), constant_values=1.0),
        )
        return jnp.broadcast_to(grey[..., None], (*grey.shape, 3))
    if view.shown == "holes":
        magenta = jnp.array([1.0, 0.0, 0.7])
        return jnp.where(gbuffer.hit[..., None], 0.6 * to_display(seen.linear), magenta)
    return to_display(relit.image)


@jax.jit
def _quantised(picture: Array) -> Array:
    return jnp.round(jnp.clip(picture, 0.0, 1.0) * 255.0).astype(jnp.uint8)


def bytes_of(picture: Float[ArrayLike, "*s 3"]) -> UInt8[np.ndarray, "*s 3"]:
    """A display-encoded picture in whole numbers."""
    return np.asarray(_quantised(picture))


def check_piece(studio: Studio, piece: Piece) -> None:
    """Raise `InputError` if there is no furniture at a piece's seed."""
    if studio.piece_mesh(piece) is None:
        raise InputError("there is no furniture here, only the room itself; click on something that stands in it")
