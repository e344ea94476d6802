"""Room of known truth: pictures under the light of its photos and under new lights.

Light is irradiance / π in the units of its sources: lux / π for our own lights and in random rooms.
"""

import dataclasses
import functools
import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

import jax
import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial import cKDTree

from hyjax.geometry.camera import Camera
from hyjax.geometry.raycast import RayCaster
from hyjax.light.kinds import Light
from hyjax.synthetic.room import render
from hyjax.synthetic.room.lightmap import select
from hyjax.synthetic.room.render import Paints
from hyjax.synthetic.surface import Surface, rows
from hyjax.synthetic.truth.opening import Opening
from hyjax.synthetic.truth.picture import Bulb, LitPicture, mean_garden, smooth_places, texel_light
from hyjax.synthetic.truth.source import Daylight, Source, direct, hard_lights, soft_lights
from hyjax.synthetic.truth.transport import Maps, TexelTransport
from hyjax.util.cache import cached_arrays
from hyjax.util.vectors import unit

VERSION = 3
"""Version of the baked light. Add one when it changes."""
FILL_DISTANCE = 0.06
"""Distance from a window's plane, in metres, within which a rectangle light fills the window."""
PROBE_SAMPLES = 16
"""Number of samples of a light at places near the surface."""
NEIGHBOURS = 24
"""Number of candidate texels near a place."""


@dataclasses.dataclass(frozen=True)
class TruthLight:
    """Baked light of some sources in a room, from `TruthRoom.bake`."""

    sources: tuple[Source, ...]
    maps: Maps


@dataclasses.dataclass(frozen=True)
class Walks:
    """Camera paths through a room: n poses of pictures w × h for photos, and of a scanner's depth maps."""

    photos: Callable[[int, int, int], list[Camera]]
    scan: Callable[[int, int, int], list[Camera]]


class TruthRoom:
    """Room with its windows, and the sources that lit its photos.

    Exposure. K is the geometric mean, channel by channel, of the photo's own light E_old over what a set of frames
    shows (`mean_light`). A photo shows albedo · E_old · e, with e the exposure `white` of each channel. Under new
    lights with a set-up's reference of R lux the truth shows albedo · E_new / R · K · e: light of R lux stands for
    the photo's mean light, and the white balance stays as it was set for the photo (`truth_exposure`).

    Args:
        name: short; names its files.
        surface: triangles, materials and charts.
        textures: of the materials; `mean` is the mean albedo of each.
        openings: its windows.
        bulbs: its lamps that are balls.
        sources: that lit its photos.
        anchors: its windows and lamps, as a capture has them.
        walks: camera paths.
        quality: of light and textures; 1 for pictures to look at.
        seed: of noise.
        leaf: material of the leaves outside.
        level: exposure by light maps, `white`.
    """

    def __init__(
        self,
        name: str,
        surface: Surface,
        textures: Paints,
        openings: list[Opening],
        bulbs: list[Bulb],
        sources: tuple[Source, ...],
        anchors: dict[str, dict[str, object]],
        walks: Walks,
        quality: float,
        seed: int,
        leaf: int,
        level: "Callable[[TruthRoom, TruthLight], Float[np.ndarray, '3']]",
    ) -> None:
        self.name, self.surface, self.textures, self.openings, self.bulbs = name, surface, textures, openings, bulbs
        self.sources, self.anchors, self.walks = sources, anchors, walks
        self.quality, self.seed = quality, seed
        self.caster = RayCaster(surface.mesh)
        self._leaf, self._level = leaf, level
        self._corners = np.concatenate([surface.uv, surface.st], axis=-1)

    @property
    def mesh(self) -> trimesh.Trimesh:
        """True surface in metres, z up; normals point into the room."""
        return self.surface.mesh

    @functools.cached_property
    def transport(self) -> TexelTransport:
        """Rays between all texels, cast on first use."""
        albedo = np.zeros((len(self.surface.nodes), 3), np.float32)
        albedo[self.surface.chart] = self.textures.mean[self.surface.material] * self.surface.tint
        side = max(2, round(7 * np.sqrt(self.quality)))
        return TexelTransport(self.surface, self.caster, albedo, self.openings, 1 / self.quality, side, self.seed)

    def bake(self, sources: Sequence[Source], folder: Path | None = None) -> TruthLight:
        """Bake the light of any sources after six bounces; the room's own are dark unless they are among them.

        Args:
            sources: `Daylight` and lights of `hyjax.light.kinds`; ambient light is left out.
            folder: keeps the result for the next time; None to keep nothing.
        """
        sources = tuple(sources)

        def make() -> dict[str, np.ndarray]:
            days = any(isinstance(s, Daylight) or _is_sky(s) for s in sources)
            radiance = functools.partial(self._radiance, sources) if days else None
            maps = self.transport.light(radiance, soft_lights(sources), hard_lights(sources))
            return dataclasses.asdict(maps)

        if folder is None:
            return TruthLight(sources, Maps(**make()))
        file = folder / f"truth-v{VERSION}-{self.name}-q{self.quality:g}-{source_key(sources)}.npz"
        return cached_arrays(file, lambda arrays: TruthLight(sources, Maps(**arrays)), make)

    @functools.cached_property
    def photo_light(self) -> TruthLight:
        """Light of the room's own sources."""
        return self.bake(self.sources)

    @functools.cached_property
    def white(self) -> Float[np.ndarray, "3"]:
        """Exposure e of the photos, per channel."""
        return np.asarray(self._level(self, self.photo_light), np.float32)

    def mean_light(self, light: TruthLight, cameras: Sequence[Camera]) -> Float[np.ndarray, "3"]:
        """Mean light K: geometric mean per channel of irradiance / π over the visible surface."""
        total, count = np.zeros(3), 0
        values = light.maps.soft + light.maps.hard + light.maps.bounce
        for camera in cameras:
            small = camera.intrinsics.resize(96, 128)
            hits = self.caster.cast(camera.origin, Camera(small, camera.pose).rays().reshape(-1, 3))
            seen = texel_light(self.transport.texels, values, self.surface, select(hits, hits.hit))
            total += np.log(np.maximum(seen, 1e-3 * seen.mean() + 1e-12)).sum(axis=0)
            count += len(seen)
        return np.exp(total / max(count, 1))

    def photograph(
        self, light: TruthLight, camera: Camera, number: int, exposure: Float[np.ndarray, "3"] | None = None
    ) -> Float[np.ndarray, "h w 3"]:
        """Photograph a picture: display-encoded in 8-bit steps.

        Args:
            light: from `bake`.
            camera: any.
            number: of the frame: its noise is drawn from it.
            exposure: of each channel; the photos' own by default.
        """
        return render.photograph(self._lit(light, number, exposure), camera, number)

    def irradiance(
        self, light: TruthLight, points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """True (direct, bounced) irradiance / π at places near the surface, such as the vertices of another mesh.

        Each place takes the light of the nearest surface that faces alike.
        """
        position, normal, direct_light, bounce = self._near(light.maps, np.asarray(points), unit(normals, 1e-12))
        rng = np.random.default_rng((self.seed, 6))
        for source in hard_lights(light.sources):
            turn = rng.random((len(position), 2))
            direct_light = direct_light + direct(source, self.caster, position, normal, PROBE_SAMPLES, turn)
        return direct_light, bounce

    def _near(
        self, maps: Maps, points: np.ndarray, normals: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Project places to the surface, with its normals, and the soft direct and bounced light there."""
        texels = self.transport.texels
        distance, near = self._tree.query(points, NEIGHBOURS)
        near = self._open[near]
        agree = np.einsum("nkd,nd->nk", texels.normal[near], normals)
        cost = distance + np.where(agree > 0.5, 0.05 * (1 - agree), 0.3 * (1.2 - agree))
        texel = np.take_along_axis(near, cost.argmin(axis=1)[:, None], axis=1)[:, 0]
        normal, centre = texels.normal[texel], texels.position[texel]
        off = np.einsum("nk,nk->n", points - centre, normal)
        position = points - off[:, None] * normal
        hits = self.caster.cast(position + 0.01 * normal, -normal)
        found = hits.hit & (hits.distance < 0.02)
        found &= np.einsum("nk,nk->n", rows(self.surface.mesh.face_normals, hits.face), normal) > 0.7
        soft, bounce = maps.soft[texel], maps.bounce[texel]
        chosen = select(hits, found)
        soft[found] = texel_light(texels, maps.soft, self.surface, chosen)
        bounce[found] = texel_light(texels, maps.bounce, self.surface, chosen)
        position[found], normal[found], _ = smooth_places(self.surface, self.caster, chosen)
        position[~found], normal[~found] = centre[~found], texels.normal[texel[~found]]
        return position, normal, soft, bounce

    @functools.cached_property
    def _open(self) -> np.ndarray:
        return np.flatnonzero(self.transport.valid)

    @functools.cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.transport.texels.position[self._open])

    def _lit(self, light: TruthLight, number: int, exposure: Float[np.ndarray, "3"] | None) -> LitPicture:
        return LitPicture(
            self.surface,
            self._corners,
            self.caster,
            self.textures,
            self.white if exposure is None else np.asarray(exposure, np.float32),
            self.seed,
            self.transport.texels,
            light.maps,
            hard_lights(light.sources),
            soft_lights(light.sources),
            self.openings,
            self.bulbs,
            self._panes(light.sources),
            functools.partial(self._radiance, light.sources, panels=True),
            self._leaf,
            np.random.default_rng((self.seed, 5, number)),
        )

    def _radiance(
        self, sources: tuple[Source, ...], window: int, direction: Float[np.ndarray, "n 3"], panels: bool = False
    ) -> Float[np.ndarray, "n 3"]:
        """Radiance through a window; with `panels`, also of rectangle lights that fill it."""
        total = np.zeros((len(direction), 3), np.float32)
        for source in sources:
            if isinstance(source, Daylight):
                if source.window == window:
                    total += self.openings[window].sky(direction) * np.asarray(source.color, np.float32)
            elif _is_sky(source) and (emitter := source.emitter()) is not None:
                above = (direction @ emitter.direction > 0)[:, None]
                total += above * np.asarray(source.color, np.float32) * np.float32(emitter.strength / np.pi)
        return total + self._filling(sources, window) if panels else total

    def _filling(self, sources: tuple[Source, ...], window: int) -> Float[np.ndarray, "3"]:
        """Radiance of the rectangle lights that fill a window."""
        opening, total = self.openings[window], np.zeros(3, np.float32)
        for light in soft_lights(sources):
            emitter = light.emitter()
            assert emitter is not None
            across = np.cross(emitter.right, emitter.up)  # type: ignore[arg-type]
            at = emitter.position - opening.centre
            beside = max(abs(at @ axis) / (axis @ axis) for axis in (opening.right, opening.up))
            if unit(across) @ opening.normal > 0.9 and abs(at @ opening.normal) < FILL_DISTANCE and beside < 0.5:
                radiance = emitter.strength / (4 * np.linalg.norm(across) * np.pi)
                total += np.asarray(light.color, np.float32) * np.float32(radiance)
        return total

    def _panes(self, sources: tuple[Source, ...]) -> Float[np.ndarray, "w 3"]:
        """Factor of the view's texture in each window.

        A photo's daylight shows the view as a camera exposed for the room does, washed out but not burnt out.
        """
        daylight = {s.window: np.asarray(s.color) for s in self.sources if isinstance(s, Daylight)}
        panes = np.zeros((len(self.openings), 3), np.float32)
        for k in range(len(panes)):
            for source in sources:
                if isinstance(source, Daylight) and source.window == k:
                    panes[k] += np.asarray(source.color) / daylight.get(k, 1.0) / self.white
            panes[k] += self._filling(sources, k) / mean_garden(self.textures, self._leaf)
        return panes


def truth_exposure(
    white: Float[np.ndarray, "3"], mean_light: Float[np.ndarray, "3"], reference_lux: float
) -> Float[np.ndarray, "3"]:
    """Exposure of the truth under new lights, for `TruthRoom.photograph`; see `TruthRoom` for its definition.

    Args:
        mean_light: K of the photos, in irradiance / π.
        reference_lux: R of the set-up. Pictures are made of irradiance / π: hence a factor π.
    """
    return np.asarray(np.pi / reference_lux * np.asarray(mean_light) * white, np.float32)


def _is_sky(source: Source) -> bool:
    if isinstance(source, Daylight):
        return False
    emitter = source.emitter()
    return emitter is not None and emitter.kind == "sky"


def source_key(sources: Sequence[Source]) -> str:
    """Key of a source, which changes whenever the source does."""
    parts = [repr(s) if isinstance(s, Daylight) else _light_key(s) for s in sources]
    return hashlib.sha256("|".join(parts).encode()).hexdigest()[:12]


def _light_key(light: Light) -> str:
    leaves, structure = jax.tree.flatten(light)
    return f"{type(light).__name__}{structure}" + str([np.asarray(leaf, np.float32).tolist() for leaf in leaves])
