"""Ways to super-resolve depth under a colour frame: bicubic, two of OpenCV's filters, and guided diffusion.

Each has parameters, which `depth_sr` chooses among candidates on pairs that it does not report. OpenCV's filters
smooth the bicubic interpolation and may afterwards be adjusted to the source, if that is better.
`published_methods` are those of Metzger et al. without a learned guide, with the parameters of their code.
"""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.interpolate import griddata

from hyjax.core.schedule import Schedule
from hyjax.core.superresolution import adjust, coarsen, super_resolve
from hyjax.guide import normalise
from hyjax.util.errors import InputError

KAPPAS = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
RADII = (0.25, 0.5, 1.0, 2.0)  # of the guided filter, in cells of the source
EPSILONS = (1e-4, 1e-3, 1e-2, 1e-1)  # of the guided filter, for colours in [0, 1]
LAMBDAS = (1.0, 10.0, 100.0, 1000.0)  # of the global smoother
SIGMAS = (2.0, 5.0, 10.0, 20.0)  # of the global smoother, for colours in [0, 255]

DADA = {"kappa": 0.03}
DADA_STEPS = 8000
DADA_SPREAD = 1.38605  # metres: standard deviation of depth in NYU, which theirs is divided by


@dataclasses.dataclass(frozen=True, eq=False)
class Task:
    """A frame whose depth is known coarsely.

    Attributes:
        image: display values in [0, 1].
        features: of each guide, by its name.
        source: coarse depth; filled in where unknown.
        known: cells of the source.
        factor: how much coarser it is.
        bicubic: the source interpolated to the frame's size.
    """

    image: Float[np.ndarray, "h w 3"]
    features: Mapping[str, Float[Array, "h w f"]]
    source: Float[Array, "h/f w/f 1"]
    known: Bool[Array, "h/f w/f"]
    factor: int
    bicubic: Float[Array, "h w 1"]


Options = dict[str, float]


class Method(NamedTuple):
    """Method of super-resolution, with the parameters to choose from."""

    name: str
    candidates: list[Options]
    run: Callable[[Task, Options], Float[Array, "h w 1"]]


def make_task(
    image: Float[np.ndarray, "h w 3"],
    depth: Float[np.ndarray, "h w"],
    valid: Bool[np.ndarray, "h w"],
    features: Mapping[str, Float[Array, "h w f"]],
    factor: int,
    least: float,
) -> Task:
    """Coarsen depth by `factor`; cells with a smaller share of valid pixels than `least` are unknown."""
    source, known = coarsen(jnp.asarray(depth)[..., None], jnp.asarray(valid), factor, least=least)
    return Task(image, features, source, known, factor, _bicubic(source, (*depth.shape, 1)))


def methods(guides: Sequence[str], schedule: Schedule, steps: int, peers: bool) -> list[Method]:
    """All methods, for each guide those by diffusion.

    Args:
        guides: names in every task's `features`.
        schedule: of the cascade.
        steps: at full size, of Metzger's algorithm.
        peers: with OpenCV's filters.

    Raises:
        InputError: `peers`, but no OpenCV with its contributed modules.
    """
    found = [Method("bicubic", [{}], lambda task, _: task.bicubic)]
    if peers:
        ximgproc = _ximgproc()
        found += [guided_filter(ximgproc), global_smoother(ximgproc)]
    full = Schedule.uniform([(1, steps)], name="full")
    kappas = [{"kappa": kappa} for kappa in KAPPAS]
    for guide in guides:
        for name, own in ((f"{steps} steps", full), (schedule.name, schedule)):
            found.append(Method(f"{guide}, {name}", kappas, _diffusion(guide, own)))
    return found


def published_methods(steps: int) -> list[Method]:
    """Bicubic interpolation of the valid cells, and diffusion at full size under the frame and that depth.

    Source: Metzger et al., CVPR 2023, and their published code, without a learned guide.
    """
    full = Schedule.uniform([(1, steps)], kappa=DADA["kappa"], norm="mean_abs", name="dada")

    def diffused(task: Task, _: Options) -> Array:
        start = scattered_bicubic(task)
        guide = jnp.concatenate([normalise(jnp.asarray(task.image)), start / DADA_SPREAD], axis=-1)
        positive = _positive(task, start)
        return super_resolve(task.source, task.known, guide, full, task.factor, start=positive)

    return [
        Method("bicubic", [{}], lambda task, _: scattered_bicubic(task)),
        Method(f"dada, rgb, {steps} steps", [DADA], diffused),
    ]


def scattered_bicubic(task: Task) -> Float[Array, "h w 1"]:
    """Cubic interpolation between the centres of the cells that are known, the nearest of them outside."""
    h, w = task.image.shape[:2]
    known = np.asarray(task.known)
    places = (np.argwhere(known) + 0.5) * task.factor - 0.5
    values, pixels = np.asarray(task.source)[..., 0][known], np.indices((h, w)).reshape(2, -1).T
    cubic, nearest = (griddata(places, values, pixels, method=method) for method in ("cubic", "nearest"))
    return jnp.asarray(np.where(np.isnan(cubic), nearest, cubic).reshape(h, w, 1), task.source.dtype)


def guided_filter(ximgproc: Any) -> Method:
    """He et al., *Guided image filtering*, ECCV 2010."""

    def run(task: Task, options: Options) -> Array:
        radius = max(1, round(options["radius"] * task.factor))
        bicubic = np.asarray(task.bicubic[..., 0], np.float32)
        image = np.ascontiguousarray(task.image, np.float32)
        return _kept(task, ximgproc.guidedFilter(image, bicubic, radius, options["eps"]), options)

    return Method("guided filter", _grid(radius=RADII, eps=EPSILONS, adjusted=(0, 1)), run)


def global_smoother(ximgproc: Any) -> Method:
    """Min et al., *Fast global image smoothing based on weighted least squares*, TIP 2014."""

    def run(task: Task, options: Options) -> Array:
        image = np.round(255 * task.image).astype(np.uint8)
        bicubic = np.asarray(task.bicubic[..., 0], np.float32)
        smooth = ximgproc.fastGlobalSmootherFilter(image, bicubic, options["lambda"], options["sigma"])
        return _kept(task, smooth, options)

    return Method("global smoother", _grid(**{"lambda": LAMBDAS}, sigma=SIGMAS, adjusted=(0, 1)), run)


def _diffusion(guide: str, schedule: Schedule) -> Callable[[Task, Options], Array]:
    def run(task: Task, options: Options) -> Array:
        kappa = np.float32(options["kappa"])
        levels = tuple(dataclasses.replace(level, kappa=kappa) for level in schedule.levels)
        start = _positive(task, task.bicubic)
        own = dataclasses.replace(schedule, levels=levels)
        return super_resolve(task.source, task.known, task.features[guide], own, task.factor, start=start)

    return run


def _bicubic(source: Float[Array, "h/f w/f 1"], shape: tuple[int, int, int]) -> Float[Array, "h w 1"]:
    return jax.image.resize(source, shape, "cubic")


def _positive(task: Task, y: Float[Array, "h w 1"]) -> Float[Array, "h w 1"]:
    """Positive pictures, which can be adjusted: bicubic interpolation overshoots beside jumps."""
    return jnp.maximum(y, 0.5 * jnp.min(task.source))


def _kept(task: Task, y: Float[np.ndarray, "h w"], options: Options) -> Float[Array, "h w 1"]:
    filtered = jnp.asarray(y)[..., None]
    if not options["adjusted"]:
        return filtered
    return adjust(_positive(task, filtered), task.source, task.known, task.factor)


def _grid(**values: Sequence[float]) -> list[Options]:
    return [dict(zip(values, chosen)) for chosen in itertools.product(*values.values())]


def _ximgproc() -> Any:
    try:
        from cv2 import ximgproc
    except ImportError:
        raise InputError(
            "peers: need OpenCV with its contributed modules; pip install opencv-contrib-python-headless, or leave "
            "them out by --no-peers"
        ) from None
    return ximgproc
