"""A real place under two lights: its surface, the family of new lights on it, and the photo relit by each."""

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
import trimesh
from jaxtyping import Bool, Float

from experiments.paper_view import with_kappa
from experiments.peers import optional
from hyjax.configuration import Configuration
from hyjax.core.cascade import cascade
from hyjax.core.refine import cascade_known, shadow_pass
from hyjax.core.schedule import PAPER_KAPPA, Schedule
from hyjax.data.capture import Capture, Frame
from hyjax.data.relit_pairs import RelitPair, open_relit_pairs
from hyjax.geometry.transport_rays import CELLS
from hyjax.guide.edge_weights import configured_edges
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import AmbientLight, DirectionalLight, Light, PointLight
from hyjax.light.light_edges import edge_correction
from hyjax.light.photo_light import LEAST_PHOTO_LIGHT, SurfaceLight, on_pixels
from hyjax.light.setup import LightSetup
from hyjax.light.shading import shade_each
from hyjax.light.shadow_map import visibilities
from hyjax.light.transport import bounce
from hyjax.pipeline import refine_illuminance, refine_visibility
from hyjax.scene.scene import Scene
from hyjax.util.errors import InputError
from hyjax.util.files import digest

Geometry = Literal["true", "rough"]
VERTICES_ACROSS = {"true": 120, "rough": 48}
"""Vertices across the picture: of the true surface, and of one such as a headset has."""
ROUGH_NOISE = 0.01
"""Standard deviation of the rough surface's depth, relative."""
STEEPEST_JUMP = 0.06
"""Largest relative difference of depth between the corners of a triangle."""
BURNT_VALUE = 0.97
"""Display value from which a pixel of either picture is burnt, and left out."""
DIRECTIONS, LAMP_GRID = 12, (4, 3, 3)
UP = np.array([0.0, -1.0, 0.0])
INNER_COSINE = 0.5
"""Cosine with the vertical from which all of a lamp's light leaves its shade; half of it at half of that."""
BOUNCE_CHANNELS = 48


def named_pairs(folder: Path, names: Sequence[str]) -> list[RelitPair]:
    """Pairs of a folder, by name.

    Raises:
        InputError: one is not there.
    """
    known = {pair.name: pair for pair in open_relit_pairs(folder)}
    if unknown := [name for name in names if name not in known]:
        raise InputError(f"pairs: {folder} has no {unknown[0]!r}; it has {', '.join(known)}")
    return [known[name] for name in names]


class OnePhoto(Capture):
    """One picture of a place as a capture."""

    def __init__(self, name: str, image: np.ndarray, pair: RelitPair) -> None:
        self.name, self.up = name, UP
        self._frame = Frame("photo", np.asarray(image, np.float32), pair.camera, 0.0)

    @property
    def fingerprint(self) -> str:
        """See `Capture`."""
        return digest([self.name, np.ascontiguousarray(self._frame.image).tobytes().hex()])

    def __len__(self) -> int:
        return 1

    def __getitem__(self, index: int) -> Frame:
        if index not in (0, -1):
            raise IndexError(index)
        return self._frame


def depth_of(pair: RelitPair) -> Float[np.ndarray, "h w"]:
    """Depth of a pair: its own, or by stereo from the picture of the other camera (semi-global matching).

    Source: Hirschmüller, "Stereo processing by semiglobal matching and mutual information", PAMI 2008; OpenCV's.

    Raises:
        InputError: stereo is needed and OpenCV is missing.
    """
    if pair.depth is not None:
        return pair.depth
    cv2 = optional("cv2")
    if cv2 is None or pair.partner is None:
        raise InputError(f"{pair.name}: has no depth; stereo needs OpenCV: pip install hyjax[experiments]")
    left_k, shape = pair.depth_camera.intrinsics, pair.partner.shape[:2]
    left = (255 * pair.partner).astype(np.uint8)
    right = cv2.resize(
        (255 * pair.pictures[0]).astype(np.uint8), (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC
    )
    scale = shape[1] / pair.camera.intrinsics.width
    offset = pair.camera.intrinsics.cx * scale - left_k.cx
    matcher = cv2.StereoSGBM_create(
        0, 80, 5, P1=8 * 3 * 25, P2=32 * 3 * 25, disp12MaxDiff=1, uniquenessRatio=8, speckleWindowSize=120,
        speckleRange=2, mode=cv2.STEREO_SGBM_MODE_HH,
    )  # fmt: skip
    disparity = matcher.compute(left, right).astype(np.float32) / 16
    disparity = np.where(disparity > 0, cv2.medianBlur(disparity, 5), -1)
    known = disparity > 0
    return np.where(known, left_k.fx * pair.baseline / np.maximum(disparity + offset, 1.0), 0.0).astype(np.float32)


def surface(pair: RelitPair, geometry: Geometry) -> trimesh.Trimesh:
    """Mesh of a pair's depth: its grid, torn at jumps; the rough one is coarse and noisy."""
    depth, camera = depth_of(pair), pair.depth_camera
    step = max(1, round(depth.shape[1] / VERTICES_ACROSS[geometry]))
    if geometry == "rough":
        depth = _coarse(depth, step) * (1 + ROUGH_NOISE * np.random.default_rng(0).normal(size=depth.shape))
    points = camera.unproject(depth)[step // 2 :: step, step // 2 :: step]
    z = depth[step // 2 :: step, step // 2 :: step]
    number = np.arange(z.size).reshape(z.shape)
    a, b, c, d = (n.ravel() for n in (number[:-1, :-1], number[1:, :-1], number[:-1, 1:], number[1:, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([c, b, d], axis=1)])
    corners = z.ravel()[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    slack = STEEPEST_JUMP if geometry == "true" else 2 * STEEPEST_JUMP
    faces = faces[(low > 0) & (high < (1 + slack) * low)]
    mesh = trimesh.Trimesh(points.reshape(-1, 3), faces, process=False)
    mesh.remove_unreferenced_vertices()
    return mesh


def _coarse(depth: np.ndarray, step: int) -> np.ndarray:
    """Median of the known depth around each pixel of the coarse grid."""
    half, out = step // 2, np.zeros_like(depth)
    for y in range(half, depth.shape[0], step):
        for x in range(half, depth.shape[1], step):
            around = depth[max(0, y - half) : y + half + 1, max(0, x - half) : x + half + 1]
            known = around[around > 0]
            out[y, x] = np.median(known) if len(known) > around.size / 4 else 0.0
    return out


def family(mesh: trimesh.Trimesh) -> tuple[tuple[Light, ...], list[int]]:
    """Lights that every method may use, of unit strength, and which of them are the lamps of the grid."""
    white = jnp.ones(3)
    golden = (1 + 5**0.5) / 2
    corners = [(0, a, b * golden) for a in (-1, 1) for b in (-1, 1)]
    directions = np.array([np.roll(corner, turn) for corner in corners for turn in range(3)], float)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    distant = [DirectionalLight(jnp.asarray(d, jnp.float32), jnp.float32(1.0), white) for d in directions]
    low, high = np.quantile(np.asarray(mesh.vertices), [0.01, 0.99], axis=0)
    low[2] *= 0.5  # towards the camera, which sees nothing of what is beside it
    ticks = [low[k] + (np.arange(n) + 0.5) / n * (high[k] - low[k]) for k, n in enumerate(LAMP_GRID)]
    places = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    lamps = [PointLight(jnp.asarray(p, jnp.float32), jnp.float32(4 * np.pi), white) for p in places]
    lights = (AmbientLight(jnp.float32(1.0), white), *distant, *lamps)
    return lights, list(range(1 + DIRECTIONS, len(lights)))


def through_shades(
    position: Float[np.ndarray, "*s 3"], lamps: Float[np.ndarray, "l 3"]
) -> Float[np.ndarray, "*s k"]:
    """Share of each lamp's light that leaves a shade open above, and one open below: spots of 60 to 90 degrees.

    Args:
        position: of points that are lit.
        lamps: their positions.

    Returns:
        All lamps with light upwards, then all with light downwards.
    """
    to = np.asarray(position)[..., None, :] - lamps
    cosine = to @ UP / np.maximum(np.linalg.norm(to, axis=-1), 1e-6)
    t = np.clip(np.concatenate([cosine, -cosine], axis=-1) / INNER_COSINE, 0, 1)
    return t * t * (3 - 2 * t)


class RealPlace:
    """One direction of a pair: photo, target, surface and lights.

    Args:
        pair: of one place.
        flipped: whether the second picture is the photo.
        geometry: of the surface.
        mesh: where it was made before.
    """

    def __init__(
        self, pair: RelitPair, flipped: bool, geometry: Geometry, mesh: trimesh.Trimesh | None = None
    ) -> None:
        self.pair, (first, second) = pair, pair.pictures[:: -1 if flipped else 1]
        self.photo, self.target = np.asarray(first, np.float64), np.asarray(second, np.float64)
        self.mesh = surface(pair, geometry) if mesh is None else mesh
        name = f"{pair.name} {'b' if flipped else 'a'} {geometry}"
        self.scene = Scene(OnePhoto(name, first, pair), self.mesh)
        frame = self.scene.frame(0)
        self.gbuffer = self.scene.gbuffer(frame.camera, rays=True)
        self.view = self.scene.view(0)
        self.lights, self.lamps = family(self.mesh)

    @functools.cached_property
    def valid(self) -> Bool[np.ndarray, "h w"]:
        """Pixels that are burnt in neither picture."""
        return (np.maximum(self.photo, self.target) < BURNT_VALUE).all(axis=2)

    @functools.cached_property
    def paper(self) -> Float[np.ndarray, "h w k"]:
        """Filters of the family as the paper makes them: holes black, all trusted, and shadows apart."""
        schedule = with_kappa(Schedule.preset("paper-80"), PAPER_KAPPA)
        maps = self.scene.shadow_maps(LightSetup.of(self.lights), occluders="surface")
        each = shade_each(self.gbuffer, self.lights)
        seen = visibilities(self.gbuffer, self.lights, maps)
        hit = self.gbuffer.hit[..., None]
        raw = jnp.where(hit, each, 0.0)
        refined = cascade(raw, self.view.display, schedule)
        shadow = shadow_pass(jnp.where(hit, seen, 1.0), self.view.display, Schedule.preset("shadow"))
        return np.asarray(refined * shadow)

    def _refined(self, occluders: Any, shadow_schedule: Schedule) -> Float[np.ndarray, "h w k"]:
        maps = self.scene.shadow_maps(LightSetup.of(self.lights), occluders=occluders)
        shaded = self.view.shade(self.lights, shadow_maps=maps)
        light = refine_illuminance(shaded, self.view.display, Configuration().schedule)
        return np.asarray(light * refine_visibility(shaded, self.view.display, shadow_schedule))

    @functools.cached_property
    def before(self) -> Float[np.ndarray, "h w k"]:
        """Direct light of the family as hyjax 0.1 made it."""
        return self._refined("surface", Schedule.preset("hyjax-shadow"))

    @functools.cached_property
    def direct(self) -> Float[np.ndarray, "h w k"]:
        """Direct light of the family by the default."""
        return self._refined("completed", Configuration().shadow_schedule)

    def on_pixels(self, values: np.ndarray) -> Float[np.ndarray, "h w c"]:
        """Values on the vertices at the pixels, refined as the light on a surface is."""
        fields = [
            on_pixels(jnp.asarray(values[:, k : k + 3], jnp.float32), self.scene.caster.arrays.faces, self.gbuffer)
            for k in range(0, values.shape[1], 3)
        ]
        channels = jnp.concatenate(fields, axis=-1)[..., : values.shape[1]]
        known = self.gbuffer.hit[..., None].astype(jnp.float32)
        return np.asarray(cascade_known(channels, known, self.view.display, Configuration().schedule))

    @functools.cached_property
    def estimated(self) -> Float[np.ndarray, "h w 3"]:
        """Photo's own light as it was estimated, at the pixels."""
        field = np.asarray(self.scene.photo_light.estimate.light.illuminance)
        return np.maximum(self.on_pixels(field), LEAST_PHOTO_LIGHT)

    @functools.cached_property
    def own(self) -> Float[np.ndarray, "h w 3"]:
        """The same by the default, with light edges."""
        estimate = self.scene.photo_light.estimate.light
        light = SurfaceLight(estimate.illuminance, None, self.scene.caster.arrays.faces)
        weights = configured_edges(Configuration().light, light)
        if weights is None:
            return self.estimated
        correction = edge_correction(self.view, jnp.asarray(self.estimated, jnp.float32), weights)
        return np.maximum(self.estimated * np.asarray(correction), LEAST_PHOTO_LIGHT)

    def _shades_at(self, position: np.ndarray) -> Float[np.ndarray, "*s k"]:
        lamps = np.stack([np.asarray(self.lights[k].position) for k in self.lamps])  # type: ignore[attr-defined]
        return through_shades(position, lamps)

    @functools.cached_property
    def shades(self) -> Float[np.ndarray, "h w l"]:
        """Share of each lamp's light that leaves its shade, at the pixels, holes filled; see `through_shades`."""
        shares = jnp.asarray(self._shades_at(self.gbuffer.position), jnp.float32)
        known = self.gbuffer.hit[..., None].astype(jnp.float32)
        return np.asarray(cascade_known(shares, known, self.view.display, Configuration().schedule))

    def shaded_lamps(self, direct: Float[np.ndarray, "h w k"]) -> Float[np.ndarray, "h w l"]:
        """Direct light of the lamps through their shades.

        Args:
            direct: light of the family.
        """
        return np.concatenate([direct[..., self.lamps]] * 2, axis=-1) * self.shades

    @functools.cached_property
    def bounced(self) -> Float[np.ndarray, "h w k 3"]:
        """Light of the family by way of other surfaces; none of the ambient's, which is everywhere."""
        by_light = self._bounced[:, :, : len(self.lights) - 1]
        return np.concatenate([np.zeros_like(by_light[:, :, :1]), by_light], axis=2)

    @functools.cached_property
    def bounced_shaded(self) -> Float[np.ndarray, "h w l 3"]:
        """Light of the lamps through their shades by way of other surfaces."""
        return self._bounced[:, :, len(self.lights) - 1 :]

    @functools.cached_property
    def _bounced(self) -> Float[np.ndarray, "h w k 3"]:
        """Bounces of all lights but ambient, and of lamps through their shades."""
        photo = self.scene.photo_light.estimate.light
        transport, own = photo.transport, self.lights[1:]
        maps = self.scene.shadow_maps(LightSetup.of(self.lights))[1:]
        count = transport.position.shape[0]
        points = GBuffer(
            transport.position[None], transport.normal[None], jnp.ones((1, count)), jnp.ones((1, count), bool)
        )
        direct = np.asarray(shade_each(points, own) * visibilities(points, own, maps))[0]
        lamps = direct[:, np.array(self.lamps) - 1]
        shaded = np.concatenate([lamps, lamps], axis=1) * self._shades_at(transport.position)
        direct, found = np.concatenate([direct, shaded], axis=1), []
        for k in range(0, direct.shape[1], BOUNCE_CHANNELS // 3):
            part = np.repeat(direct[:, k : k + BOUNCE_CHANNELS // 3], 3, axis=1)
            indirect = bounce(transport, photo.albedo, jnp.asarray(part, jnp.float32))
            found.append(np.asarray(indirect[: transport.vertices]))
        pixels = self.on_pixels(np.concatenate(found, axis=1))
        return pixels.reshape(*pixels.shape[:2], direct.shape[1], 3)

    @functools.cached_property
    def glow(self) -> Float[np.ndarray, "h w g"]:
        """Light of unit patches of the box, four on each wall, that rays from the surface end on."""
        transport = self.scene.photo_light.estimate.transport
        first, vertices = len(self.mesh.faces), transport.vertices
        patch = np.asarray(transport.hits)[:, :vertices].astype(np.int64) - first
        row, column = (patch // CELLS) % CELLS, patch % CELLS
        large = (patch // CELLS**2) * 4 + 2 * (row // (CELLS // 2)) + column // (CELLS // 2)
        inside = (patch >= 0) & (patch < 6 * CELLS**2)
        at = np.where(inside, large + 24 * np.arange(vertices), 24 * vertices)
        share = np.bincount(at.ravel(), minlength=24 * vertices + 1)[:-1].reshape(vertices, 24) / len(patch)
        return self.on_pixels(share)
