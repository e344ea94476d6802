"""Random rooms of known truth under any light; their photos have daylight, lamps or both."""

import functools

import numpy as np
from jaxtyping import Float, Int

from hyjax.geometry.raycast import RayCaster
from hyjax.light.kinds import Light
from hyjax.synthetic.random_room import bank_of
from hyjax.synthetic.random_room.fittings import REVEAL_DEPTH
from hyjax.synthetic.random_room.layout import plan
from hyjax.synthetic.random_room.looks import Looks
from hyjax.synthetic.truth.lamps import add_lamps
from hyjax.synthetic.truth.opening import Opening
from hyjax.synthetic.truth.picture import Bulb
from hyjax.synthetic.truth.room import TruthLight, TruthRoom, Walks
from hyjax.synthetic.truth.source import Daylight, Source
from hyjax.synthetic.truth.walk import FIELD_DEGREES, walk

MIDDLE_WHITE = 0.56
"""Display-linear value of white under the photo's mean light, as in the built-in room."""
BALANCED_SHARE = 0.75
"""Share of the light's colour that the camera's white balance removes."""
SKY_LUMINANCE = (700.0, 2600.0)
"""Range of the sky's luminance in windows, in candela per square metre."""
GLOSS_LIMIT = 0.9


class LookPaints:
    """Looks as materials of the built-in room's renderer, with one more for the leaves outside.

    Attributes:
        gloss, blur: of the mirror image of each look.
        mean: mean albedo of each.
        leaf: the look of leaves.
    """

    def __init__(self, looks: Looks, rng: np.random.Generator) -> None:
        self.leaf = looks.draw(rng, "leaf", 0.5)
        every = np.arange(self.leaf + 1)
        gloss, shine = looks.gloss(every)
        self.gloss = np.minimum(gloss, GLOSS_LIMIT).astype(np.float32)
        self.blur = np.clip(8.5 - 2.8 * np.log10(np.maximum(shine, 1)), 1, 7).astype(np.float32)
        self.mean = looks.mean(every)
        self._looks = looks

    def __call__(
        self, material: Int[np.ndarray, "n"], uv: Float[np.ndarray, "n 2"], footprint: Float[np.ndarray, "n"]
    ) -> Float[np.ndarray, "n 3"]:
        """Linear albedo at `uv` (metres), filtered to `footprint` (metres a pixel)."""
        if not len(material):
            return np.zeros((0, 3), np.float32)
        return self._looks.albedo(material, uv.astype(np.float32), footprint.astype(np.float32)).astype(np.float32)


def lit_random_room(seed: int, number: int, by: str, quality: float = 1.0) -> TruthRoom:
    """Random room `number` of a seed. The first room of a seed in a process draws its patterns, too.

    Args:
        by: the light of its photos: `day`, `lamps` or `both`.
    """
    key = (seed, number)
    build, size, windows = plan(np.random.default_rng(key), bank_of(seed))
    rng = np.random.default_rng((*key, 8))
    lights: list[Light] = []
    anchors: dict[str, dict[str, object]] = {}
    bulbs: list[Bulb] = []
    if by != "day":
        caster = RayCaster(build.finish().mesh)
        lights, anchors, bulbs = add_lamps(build, caster, size, int(rng.integers(1, 4)), rng)
    surface = build.finish()
    openings = [Opening(w.centre, w.right, w.up, w.normal, REVEAL_DEPTH) for w in windows]
    sources: list[Source] = list(lights)
    if by != "lamps":
        for k in range(len(openings)):
            warm = rng.uniform(-0.08, 0.12)
            level = rng.uniform(*SKY_LUMINANCE) * (0.5 if by == "both" else 1.0)
            sources.append(Daylight(k, (level * (1 - warm), level, level * (1 + warm))))
    anchors |= {f"window_{k}": opening.anchor() for k, opening in enumerate(openings)}
    anchors["bounds"] = {"low": [0.0, 0.0, 0.0], "high": [float(x) for x in size]}
    paints = LookPaints(build.looks, rng)
    caster = RayCaster(surface.mesh)
    photos, scan = (functools.partial(walk, caster, size, (*key, k), f) for k, f in ((0, FIELD_DEGREES), (1, 62.7)))
    return TruthRoom(
        f"random-{seed}-{number}-{by}",
        surface,
        paints,
        openings,
        bulbs,
        tuple(sources),
        anchors,
        Walks(photos, scan),
        quality,
        seed * 1000 + number,
        paints.leaf,
        _level,
    )


def _level(room: TruthRoom, light: TruthLight) -> Float[np.ndarray, "3"]:
    """Exposure of the mean light to middle brightness, with most of its colour balanced."""
    mean = room.mean_light(light, room.walks.photos(12, 160, 120))
    return MIDDLE_WHITE / (mean.mean() ** (1 - BALANCED_SHARE) * mean**BALANCED_SHARE)
