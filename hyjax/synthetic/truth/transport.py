"""Transport of light between a room's texels: rays are cast once, and serve all sources."""

import dataclasses
import functools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Bool, Float, Int

from hyjax.geometry.raycast import RayCaster
from hyjax.light.kinds import Light
from hyjax.synthetic.room.light import (
    BOUNCES,
    CHUNK_RAYS,
    OFFSET,
    WORKERS,
    cosine_lobe,
    frames,
    group,
    mean_of,
    smooth,
    strata,
)
from hyjax.synthetic.room.lightmap import Texels, at_hits
from hyjax.synthetic.room.render import select
from hyjax.synthetic.surface import Surface, rows
from hyjax.synthetic.truth.opening import Opening, Radiance, cosine_share, from_opening, leaving
from hyjax.synthetic.truth.source import direct

HARD_SAMPLES = 8
"""Number of shadow rays of a texel to a bulb or the sun."""


@dataclasses.dataclass(frozen=True)
class Maps:
    """Light maps, irradiance / π of each texel.

    Attributes:
        soft: direct light of windows and panels.
        hard: direct light of bulbs, spots and the sun.
    """

    soft: Float[np.ndarray, "t 3"]
    hard: Float[np.ndarray, "t 3"]
    bounce: Float[np.ndarray, "t 3"]


class TexelTransport:
    """Light transport by rays between the texels of a room.

    Args:
        scale: coarsens the texels.
        side: each texel casts side² rays for bounces, and as many towards each window and panel.
    """

    def __init__(
        self,
        surface: Surface,
        caster: RayCaster,
        albedo: Float[np.ndarray, "c 3"],
        openings: list[Opening],
        scale: float,
        side: int,
        seed: int,
    ) -> None:
        self._surface, self._caster, self._openings, self._side, self._seed = surface, caster, openings, side, seed
        self.texels = Texels(surface, scale)
        step = max(1, CHUNK_RAYS // side**2)
        self._chunks = [slice(a, min(a + step, len(self.texels))) for a in range(0, len(self.texels), step)]
        rng = np.random.default_rng((seed, 2))
        self._lobe = cosine_lobe(strata(side, 4, rng)).astype(np.float32)
        self._square = strata(side, 2, rng)
        with ThreadPoolExecutor(WORKERS) as pool:
            parts = list(pool.map(self._gather, self._chunks))
        self._hit_texels = [part[0] for part in parts]
        self._distance = np.concatenate([part[1] for part in parts])
        self.valid: Bool[np.ndarray, t] = np.concatenate([part[2] for part in parts])
        self._escaped = [part[3] for part in parts]
        self._albedo = np.where(self.valid[:, None], albedo[self.texels.chart], 0.0).astype(np.float32)

    def light(self, radiance: Radiance | None, soft: Sequence[Light], hard: Sequence[Light]) -> Maps:
        """Light of some sources after all bounces.

        Args:
            radiance: through the windows; None for a dark night.
        """
        near = np.zeros((len(self.texels), 3), np.float32)
        sharp = np.zeros_like(near)
        if radiance is not None:
            near += np.concatenate([self._through_windows(k, radiance) for k in range(len(self._chunks))])
        turn = self._turn()
        for lights, total, samples in ((soft, near, self._side**2), (hard, sharp, HARD_SAMPLES)):
            step = max(1, 4 * CHUNK_RAYS // samples)
            for light in lights:
                for a in range(0, len(total), step):
                    some = slice(a, a + step)
                    p, n = self.texels.position[some], self.texels.normal[some]
                    total[some] += direct(light, self._caster, p, n, samples, turn[some])
        bounce = self.bounced(near + sharp)
        none = np.zeros_like(near)
        maps = ((near, none), (sharp, none), (none, bounce))
        return Maps(*(smooth(self.texels, a, b, self._distance, self.valid) for a, b in maps))

    def bounced(self, first: Float[np.ndarray, "t 3"]) -> Float[np.ndarray, "t 3"]:
        """Indirect light from direct light after `BOUNCES` bounces."""
        total, indirect = first, np.zeros_like(first)
        with ThreadPoolExecutor(WORKERS) as pool:
            for _ in range(BOUNCES):
                # One dark row more: rays that leave, or meet a back side, point at it.
                radiance = np.concatenate([self._albedo * total, np.zeros((1, 3), np.float32)])
                indirect = np.concatenate(list(pool.map(lambda h: mean_of(radiance, h), self._hit_texels)))  # noqa: B023
                total = first + indirect
        return indirect

    def _turn(self) -> Float[np.ndarray, "t 2"]:
        """Shift of each texel's samples; sixteen neighbours take different ones."""
        cell = self.texels.i % 4 + 4 * (self.texels.j % 4)
        place = np.random.default_rng((self._seed, 3)).permutation(16)[cell]
        return np.stack([(place / 16.0) % 1, (place * 7 / 16.0 + 0.03) % 1], axis=-1)

    def _gather(
        self, chunk: slice
    ) -> tuple[Int[np.ndarray, "n k"], Float[np.ndarray, "n"], Bool[np.ndarray, "n"], tuple[np.ndarray, ...]]:
        """Texels that rays hit, their mean distance, whether the place is in the open, and rays that left."""
        surface, texels, openings = self._surface, self.texels, self._openings
        normal = texels.normal[chunk]
        origin = texels.position[chunk] + OFFSET * normal
        n, rays = len(origin), self._side**2
        flat = np.matmul(self._lobe[group(texels, chunk, 4)], frames(normal)).reshape(-1, 3)
        origins = np.repeat(origin, rays, axis=0)
        hits = self._caster.cast(origins, flat)
        front = np.einsum("nk,nk->n", rows(surface.mesh.face_normals, hits.face), flat) < 0
        hit_texels = np.full(n * rays, len(texels), np.int32)
        lit = hits.hit & front
        chosen = select(hits, lit)
        hit_texels[lit] = texels.nearest(rows(surface.chart, chosen.face), at_hits(surface.st, chosen))
        near = np.minimum(np.where(hits.hit, hits.distance, 10.0), 10.0).reshape(n, rays)
        inside = (hits.hit & ~front).reshape(n, rays).mean(axis=1)
        away = np.flatnonzero(~hits.hit)
        through = leaving(openings, origins[away], flat[away])
        away, through = away[through >= 0], through[through >= 0]
        return (
            hit_texels.reshape(n, rays),
            1 / (1 / (near + 1e-3)).mean(axis=1),
            inside < 0.4,
            (away, through, flat[away]),
        )

    def _through_windows(self, number: int, radiance: Radiance) -> Float[np.ndarray, "n 3"]:
        chunk, rays = self._chunks[number], self._side**2
        normal = self.texels.normal[chunk]
        origin = self.texels.position[chunk] + OFFSET * normal
        away, through, direction = self._escaped[number]
        found = np.zeros((len(away), 3), np.float32)
        total = np.zeros_like(origin)
        square = self._square[group(self.texels, chunk, 2)]
        for k, opening in enumerate(self._openings):
            mine = through == k
            place = away[mine] // rays
            share = cosine_share(opening, origin[place], direction[mine], normal[place])
            found[mine] = radiance(k, direction[mine]) * share[:, None]
            if radiance(k, (np.array([0, 0, 0.5]) - opening.normal)[None].astype(np.float32)).any():
                total += from_opening(self._caster, opening, functools.partial(radiance, k), origin, normal, square)
        place = away // rays
        for channel in range(3):
            total[:, channel] += np.bincount(place, found[:, channel], len(origin)) / rays
        return total.astype(np.float32)
