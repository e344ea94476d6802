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
    CHUNK_RAYS,
    OFFSET,
    WORKERS,
    bounced,
    chunks_of,
    gather,
    group,
    patterns,
    smooth,
)
from hyjax.synthetic.room.lightmap import Texels
from hyjax.synthetic.surface import Surface
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
        self._chunks = chunks_of(self.texels, side)
        self._lobe, self._square = patterns(side, seed)
        with ThreadPoolExecutor(WORKERS) as pool:
            parts = list(pool.map(self._gather, self._chunks))
        self._hit_texels = [part[0] for part in parts]
        self._distance = np.concatenate([part[1] for part in parts])
        self.valid: Bool[np.ndarray, t] = np.concatenate([part[2] for part in parts])
        self._escaped = [part[3] for part in parts]
        self._albedo = albedo

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
        bounce = bounced(near + sharp, self.texels, self._albedo, self.valid, self._hit_texels)
        none = np.zeros_like(near)
        maps = ((near, none), (sharp, none), (none, bounce))
        return Maps(*(smooth(self.texels, a, b, self._distance, self.valid) for a, b in maps))

    def _turn(self) -> Float[np.ndarray, "t 2"]:
        """Shift of each texel's samples; sixteen neighbours take different ones."""
        cell = self.texels.i % 4 + 4 * (self.texels.j % 4)
        place = np.random.default_rng((self._seed, 3)).permutation(16)[cell]
        return np.stack([(place / 16.0) % 1, (place * 7 / 16.0 + 0.03) % 1], axis=-1)

    def _gather(
        self, chunk: slice
    ) -> tuple[Int[np.ndarray, "n k"], Float[np.ndarray, "n"], Bool[np.ndarray, "n"], tuple[np.ndarray, ...]]:
        """Texels that rays hit, their mean distance, whether the place is in the open, and rays that left."""
        rays = gather(self._surface, self._caster, self.texels, chunk, self._lobe)
        away = np.flatnonzero(~rays.hit)
        direction = rays.direction[away]
        through = leaving(self._openings, rays.origin[away // self._side**2], direction)
        left = through >= 0
        return rays.hit_texels, rays.distance, rays.valid, (away[left], through[left], direction[left])

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
