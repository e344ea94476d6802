"""Schedule of a cascade: its resolutions, the number and size of steps, the sensitivity to edges."""

import dataclasses
import functools
import itertools
import json
from collections.abc import Iterable
from typing import Any, Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import ArrayLike, Float

from hyjax.core.checks import check_fidelity, check_kappa, check_step_sizes
from hyjax.core.diffusion import Norm
from hyjax.core.equality import equal_by_value
from hyjax.core.presets import DEFAULT_KAPPA as DEFAULT_KAPPA
from hyjax.core.presets import GUIDED_FIDELITY as GUIDED_FIDELITY
from hyjax.core.presets import GUIDED_KAPPA as GUIDED_KAPPA
from hyjax.core.presets import GUIDED_OPTIONS, PRESETS
from hyjax.core.presets import PAPER_KAPPA as PAPER_KAPPA
from hyjax.core.step_size import DEFAULT_LAM
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError, did_you_mean, shown
from hyjax.util.reading import parse_json
from hyjax.util.tracing import concrete

Pooling = Literal["edges", "guide"]
Upsampling = Literal["bilinear", "guide"]

MOST_STEPS = 100_000
"""Most steps of a schedule, all levels together."""
MOST_FACTOR = 4096
"""Largest downsampling factor of a level."""


@equal_by_value
@functools.partial(
    jax.tree_util.register_dataclass, data_fields=["step_sizes", "kappa", "fidelity"], meta_fields=["factor"]
)
@dataclasses.dataclass(frozen=True, eq=False)
class Level:
    """Diffusion at one resolution.

    Attributes:
        factor: downsampling factor of the full frame, ≥ 1 (static).
        step_sizes: λ of each step, in (0, 1/4) or a stable cycle (see `hyjax.core.cycles`); as many steps as
            entries, possibly none.
        kappa: edge sensitivity κ > 0 at this level, in the guide's units.
        fidelity: α ≥ 0: how much each step holds on to the level's cell means (see `diffuse`); None, as in the
            paper, leaves that term out.
    """

    factor: int
    step_sizes: Float[ArrayLike, "n"]
    kappa: Float[ArrayLike, ""]
    fidelity: Float[ArrayLike, ""] | None = None

    @property
    def steps(self) -> int:
        return jnp.shape(self.step_sizes)[0]


@equal_by_value
@functools.partial(
    jax.tree_util.register_dataclass, data_fields=["levels"], meta_fields=["pooling", "norm", "name", "upsampling"]
)
@dataclasses.dataclass(frozen=True, eq=False)
class Schedule:
    """Levels from coarse to fine. Step sizes, κ and α are leaves of a pytree; the rest is static.

    An optimiser that steps on the leaves themselves may leave the allowed range, which inside `jit` nothing checks:
    optimise log κ and the logit of 4 λ instead, and build the schedule from them.

    Attributes:
        levels: factors fall strictly, each a multiple of the next.
        pooling: `"edges"` takes the minimum of the fine conductances (the paper's text), `"guide"` computes
            conductances anew from the downsampled guide (the paper's equation).
        norm: norm of guide differences, see `guide_distance`.
        name: its name in tables.
        upsampling: `"bilinear"` is the paper's; `"guide"` does not mix across the guide's edges, see
            `guided_upsample`.
    """

    levels: tuple[Level, ...]
    pooling: Pooling = "edges"
    norm: Norm = "l2"
    name: str = "custom"
    upsampling: Upsampling = "bilinear"

    @classmethod
    def of(cls, schedule: "Schedule | str", *, where: str = "schedule") -> "Schedule":
        """Return a schedule as it is, or a preset by its name.

        >>> Schedule.of("hyjax").name
        'hyjax'

        Raises:
            InputError: neither of them; the message begins with `where`.
        """
        if isinstance(schedule, Schedule):
            return schedule
        if not isinstance(schedule, str):
            raise InputError(f"{where}: must be a Schedule or the name of a preset, got {shown(schedule)}")
        return cls.preset(_known_preset(schedule, where))

    @classmethod
    @checked_arguments
    def uniform(
        cls,
        steps: Iterable[tuple[int, int]],
        *,
        kappa: float = DEFAULT_KAPPA,
        lam: float = DEFAULT_LAM,
        fidelity: float | None = None,
        pooling: Pooling = "edges",
        norm: Norm = "l2",
        upsampling: Upsampling = "bilinear",
        name: str = "custom",
    ) -> "Schedule":
        """Schedule from (factor, number of steps) pairs, with one λ, one κ and one α for all levels.

        Example:
            >>> print(Schedule.uniform([(4, 15), (2, 20)], kappa=0.1))
            custom: 35 steps, pooling edges, norm l2
              factor  steps       kappa                 lam
                   4     15         0.1                0.24
                   2     20         0.1                0.24

        Raises:
            InputError: anything `check` refuses.
        """
        if not steps:
            raise InputError(f"steps: schedule {name} needs at least one level")
        levels = []
        for factor, count in steps:
            if not 0 <= count <= MOST_STEPS:
                raise InputError(
                    f"steps: schedule {name} must have 0 to {MOST_STEPS} steps, got {count} at factor {factor}"
                )
            alpha = None if fidelity is None else np.float32(fidelity)
            levels.append(Level(factor, np.full(count, lam, np.float32), np.float32(kappa), alpha))
        return cls(tuple(levels), pooling, norm, name, upsampling).check()

    @classmethod
    @checked_arguments
    def preset(cls, name: str, *, kappa: float | None = None, lam: float = DEFAULT_LAM) -> "Schedule":
        """Preset by name: our `hyjax`, `hyjax-shadow`, `hyjax-scan-shadow`; the paper's `paper-50`, `paper-80`,
        `shadow`; its baselines `naive-50`, `naive-1000`.

        >>> [(level.factor, level.steps) for level in Schedule.preset("paper-50").levels]
        [(16, 5), (8, 10), (4, 15), (2, 20)]

        Args:
            name: one of these.
            kappa: κ of all levels; default: the preset's own, for the RGB guide.
            lam: λ of all steps.

        Raises:
            InputError: unknown name.
        """
        preset = PRESETS[_known_preset(name, "schedule")]
        options = preset.options if kappa is None else preset.options | {"kappa": kappa}
        return cls.uniform(preset.steps, lam=lam, name=name, **options)

    def check(self, *, dtype: DTypeLike = np.float32) -> "Schedule":
        """Return self if it can be run in this precision. Values known only while tracing are let through.

        >>> Schedule.uniform([(2, 4)], lam=0.3)
        Traceback (most recent call last):
        hyjax.util.errors.InputError: schedule custom, factor 2, lam: ...

        Raises:
            InputError: no level, factor < 1, factors not falling or not multiples, κ ≤ 0, λ outside (0, 1/4) and no
                stable cycle, α < 0, more than `MOST_STEPS` steps in all, unknown pooling, norm or upsampling.
        """
        where = f"schedule {self.name}"
        if not (isinstance(self.levels, tuple | list) and all(isinstance(level, Level) for level in self.levels)):
            raise InputError(f"{where}: levels must be a tuple of Level, got {shown(self.levels)}")
        if not self.levels:
            raise InputError(f"{where}: needs at least one level")
        named = ((self.pooling, Pooling), (self.norm, Norm), (self.upsampling, Upsampling))
        for value, known in ((value, get_args(names)) for value, names in named):
            if not isinstance(value, str) or value not in known:
                raise InputError(f"{where}: {shown(value)} is unknown; use one of {', '.join(known)}")
        factors = [level.factor for level in self.levels]
        for factor in factors:
            if not isinstance(factor, int) or isinstance(factor, bool) or factor < 1:
                raise InputError(f"{where}: a factor is a whole number >= 1, got {shown(factor)}")
            if factor > MOST_FACTOR:
                raise InputError(f"{where}: factor {factor} is too coarse for any picture; at most {MOST_FACTOR}")
        for coarse, fine in itertools.pairwise(factors):
            if fine >= coarse:
                raise InputError(f"{where}: levels must go from coarse to fine, got factor {fine} after {coarse}")
            if coarse % fine:
                raise InputError(f"{where}: factor {coarse} is no multiple of the next finer factor {fine}")
        for level in self.levels:
            at = f"{where}, factor {level.factor}"
            check_kappa(level.kappa, f"{at}, kappa")
            check_step_sizes(level.step_sizes, f"{at}, lam", dtype)
            if level.fidelity is not None:
                check_fidelity(level.fidelity, f"{at}, fidelity")
        if (total := sum(level.steps for level in self.levels)) > MOST_STEPS:
            raise InputError(f"{where}: {total} steps in all are too many; at most {MOST_STEPS}")
        return self

    def to_json(self) -> str:
        """Schedule as JSON text; `from_json` gives the same schedule back, to the last bit of float32.

        >>> schedule = Schedule.uniform([(4, 15), (2, 20)])
        >>> Schedule.from_json(schedule.to_json()).to_json() == schedule.to_json()
        True
        """
        levels = [
            {
                "factor": level.factor,
                "steps": level.steps,
                "lam": _pack(level.step_sizes),
                "kappa": _float(level.kappa),
            }
            | ({} if level.fidelity is None else {"fidelity": _float(level.fidelity)})
            for level in self.levels
        ]
        content: dict[str, Any] = {"name": self.name, "pooling": self.pooling, "norm": self.norm}
        content |= {"upsampling": self.upsampling} if self.upsampling != "bilinear" else {}
        content |= {"levels": levels}
        return json.dumps(content, indent=2)

    @classmethod
    def from_json(cls, text: str) -> "Schedule":
        """Schedule from the JSON text of `to_json`. `lam` is one number for a level's steps, or a list of them.

        >>> Schedule.from_json("{}")
        Traceback (most recent call last):
        hyjax.util.errors.InputError: ...

        Raises:
            InputError: not JSON, a key missing or unknown, or anything `check` refuses.
        """
        content = parse_json(text, "schedule")
        names = ("name", "pooling", "norm", "upsampling")
        content = _keys("schedule", content, {"levels"}, set(names))
        if not isinstance(content["levels"], list):
            raise InputError("schedule: 'levels' must be a list of levels, coarse to fine")
        if not isinstance(content.get("name", ""), str):
            raise InputError(f"schedule: 'name' must be a text, got {content['name']!r}")
        levels = tuple(_read_level(index, level) for index, level in enumerate(content["levels"]))
        rest = {key: content[key] for key in names if key in content}
        return cls(levels, **rest).check()

    def __str__(self) -> str:
        total = sum(level.steps for level in self.levels)
        guided = "" if self.upsampling == "bilinear" else f", upsampling {self.upsampling}"
        lines = [f"{self.name}: {total} steps, pooling {self.pooling}, norm {self.norm}{guided}"]
        attached = any(level.fidelity is not None for level in self.levels)
        lines.append(f"{'factor':>8}{'steps':>7}{'kappa':>12}{'lam':>20}" + attached * f"{'fidelity':>12}")
        for level in self.levels:
            lam = concrete(level.step_sizes)
            lam_text = "traced" if lam is None else _span(lam)
            alpha_text = "-" if level.fidelity is None else _number(level.fidelity)
            line = f"{level.factor:>8}{level.steps:>7}{_number(level.kappa):>12}{lam_text:>20}"
            lines.append(line + attached * f"{alpha_text:>12}")
        return "\n".join(lines)


def guided_schedule(steps: Iterable[tuple[int, int]], *, name: str = "custom", **options: Any) -> Schedule:
    """`Schedule.uniform` in the form of our presets: guide-aware pooling and upsampling, with a data term.

    >>> schedule = guided_schedule([(8, 4), (2, 4)])
    >>> schedule.pooling, schedule.upsampling, schedule.levels[0].fidelity is not None
    ('guide', 'guide', True)

    Args:
        steps: (factor, number of steps).
        options: of `Schedule.uniform`, instead of the presets'.
    """
    return Schedule.uniform(steps, name=name, **(GUIDED_OPTIONS | options))


def _known_preset(name: str, where: str) -> str:
    if name not in PRESETS:
        known = f"{did_you_mean(name, PRESETS)}; there are {', '.join(PRESETS)}"
        raise InputError(f"{where}: no preset {shown(name)}{known}")
    return name


def _float(value: ArrayLike) -> float:
    # The shortest decimal that reads back as this float32, rather than the 17 digits of its float64 neighbour.
    return float(np.format_float_positional(np.float32(np.asarray(value)), unique=True))


def _number(value: ArrayLike) -> str:
    known = concrete(value)
    return "traced" if known is None else f"{float(known):.4g}"


def _pack(step_sizes: ArrayLike) -> float | list[float] | None:
    values = [_float(value) for value in np.asarray(step_sizes)]
    if not values:
        return None
    return values[0] if len(set(values)) == 1 else values


def _span(values: np.ndarray) -> str:
    if values.size == 0:
        return "-"
    low, high = float(values.min()), float(values.max())
    return f"{low:.3g}" if low == high else f"{low:.2g}..{high:.2g}"


def _keys(where: str, content: Any, needed: set[str], optional: set[str]) -> dict[str, Any]:
    if not isinstance(content, dict):
        raise InputError(f"{where}: must be a JSON object, got {type(content).__name__}")
    for key in needed - content.keys():
        raise InputError(f"{where}: key {key!r} is missing")
    for key in content.keys() - needed - optional:
        raise InputError(f"{where}: unknown key {key!r}; there are {', '.join(sorted(needed | optional))}")
    return content


def _read_level(index: int, content: Any) -> Level:
    where = f"schedule, level {index}"
    if isinstance(content, dict) and "attachment" in content:  # the name that version 0.1 gave it
        content = {"fidelity" if key == "attachment" else key: value for key, value in content.items()}
    content = _keys(where, content, {"factor", "steps", "kappa"}, {"lam", "fidelity"})
    factor, steps, lam = content["factor"], content["steps"], content.get("lam", DEFAULT_LAM)
    if not isinstance(steps, int) or isinstance(steps, bool) or steps < 0:
        raise InputError(f"{where}: 'steps' must be a whole number >= 0, got {shown(steps)}")
    if steps > MOST_STEPS:
        raise InputError(f"{where}: {steps} steps are too many; at most {MOST_STEPS}")
    kappa, fidelity = content["kappa"], content.get("fidelity")
    for key, value in (("kappa", kappa), ("fidelity", 0.0 if fidelity is None else fidelity), ("lam", lam)):
        numbers = value if key == "lam" and isinstance(value, list) else [value]
        if not all(type(x) in (int, float) or (x is None and steps == 0) for x in numbers):
            raise InputError(f"{where}: {key!r} must be numbers, got {shown(value)}")
    try:
        with np.errstate(over="ignore"):  # infinite, and refused as such
            kappa, fidelity = np.float32(kappa), None if fidelity is None else np.float32(fidelity)
            step_sizes = np.asarray([] if steps == 0 else lam, np.float32)
    except OverflowError:
        raise InputError(f"{where}: 'kappa', 'lam' or 'fidelity' is too large") from None
    if step_sizes.ndim == 0:
        step_sizes = np.full(steps, step_sizes)
    if step_sizes.shape != (steps,):
        raise InputError(f"{where}: 'lam' has {step_sizes.size} entries for {steps} steps")
    return Level(factor, step_sizes, kappa, fidelity)
