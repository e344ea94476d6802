"""The last convolution of a learned guide, tuned together with κ, λ and α of a schedule.

The search finds which levels take how many steps under a guide as it is. Then κ, λ, α and the guide's last layer
are all continuous, and one descent on the search's own loss moves them together. The layers before stay: what the
last one takes in is computed once a frame.

Symbols of this file: x (H, W, T) is what enters the last layer, its *trunk*; the guide is x convolved with the
kernel. A bias would cancel in every difference of the guide, so there is none to tune.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float
from tqdm import tqdm

from hyjax.core.schedule import Schedule
from hyjax.guide.choose import FrameGuide
from hyjax.guide.convolution import convolve
from hyjax.guide.inference import Guide
from hyjax.light.color import to_display
from hyjax.tuning.bench import Workbench
from hyjax.tuning.cases import Case, refined_filter, scores
from hyjax.tuning.descent import bounded
from hyjax.tuning.latency_estimator import ScheduleClock
from hyjax.tuning.monitor import RunMonitor
from hyjax.tuning.relaxation import RelaxedSchedule, prepare, relaxed_loss, relaxed_of
from hyjax.util.errors import InputError
from hyjax.util.files import write_text

ITERATIONS = 300
RATE = 0.003
HOLD = 1e-3
"""Weight of the kernel's relative squared distance from its start: a few frames cannot be trusted with more."""

Kernel = Float[Array, "k k t f"]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Joint:
    """Tuned parameters: the schedule and the guide's last layer.

    Attributes:
        point: whole steps, which stay, with κ, λ and α.
        kernel: of the guide's last convolution, in multiples of the root mean square of the one it started from.
    """

    point: RelaxedSchedule
    kernel: Kernel


@functools.partial(jax.jit, static_argnames="factors")
def joint_loss(
    joint: Joint, case: Case, trunk: Float[Array, "h w t"], scale: Float[Array, ""], factors: tuple[int, ...]
) -> Float[Array, ""]:
    """The search's loss on one frame whose guide is made with this kernel."""
    guide = convolve(trunk[None], scale * joint.kernel)[0]
    return relaxed_loss(joint.point, prepare(dataclasses.replace(case, guide=guide), factors), factors)


def tune_jointly(
    cases: Sequence[Case],
    trunks: Sequence[Float[Array, "h w t"]],
    kernel: Kernel,
    point: RelaxedSchedule,
    factors: tuple[int, ...],
    *,
    iterations: int = ITERATIONS,
    seed: int = 0,
    report: Callable[[int, float], None] = lambda iteration, loss: None,
    expired: Callable[[], bool] = lambda: False,
) -> tuple[RelaxedSchedule, Kernel, float, float]:
    """Descend (Adam, one frame an iteration) on κ, λ, α and the kernel together.

    Args:
        cases: the tuning frames; their own guides are not looked at.
        trunks: of each.
        kernel: to start from.
        point: to start from, of whole steps.
        factors: of its levels.
        iterations: updates.
        seed: of the order of frames.
        report: called with each iteration and its loss.
        expired: asked before each iteration whether to stop.

    Returns:
        (point, kernel, loss before, loss after): the best on all tuning frames; the start if none is better.
    """
    scale = jnp.sqrt(jnp.mean(kernel**2))
    start = Joint(point, kernel / scale)

    def regularised_loss(joint: Joint, case: Case, trunk: Array) -> Array:
        return joint_loss(joint, case, trunk, scale, factors) + HOLD * jnp.mean((joint.kernel - start.kernel) ** 2)

    rate = optax.cosine_decay_schedule(RATE, max(iterations, 1))
    optimizer = optax.adam(rate)

    @jax.jit
    def advance(
        joint: Joint, state: optax.OptState, case: Case, trunk: Array
    ) -> tuple[Joint, optax.OptState, Array]:
        loss, slope = jax.value_and_grad(regularised_loss)(joint, case, trunk)
        slope = dataclasses.replace(
            slope, point=dataclasses.replace(slope.point, steps=jnp.zeros_like(point.steps))
        )
        updates, state = optimizer.update(slope, state)
        joint = optax.apply_updates(joint, updates)
        return dataclasses.replace(joint, point=bounded(joint.point)), state, loss

    def mean_loss(joint: Joint) -> float:
        return float(np.mean([joint_loss(joint, c, t, scale, factors) for c, t in zip(cases, trunks, strict=True)]))

    before = mean_loss(start)
    best, lowest = start, before
    joint, state = start, optimizer.init(start)
    rng = np.random.default_rng(seed)
    for i in range(iterations):
        if expired():
            break
        frame = int(rng.integers(len(cases)))
        joint, state, loss = advance(joint, state, cases[frame], trunks[frame])
        report(i, float(loss))
        if (i + 1) % 25 == 0 or i + 1 == iterations:
            now = mean_loss(joint)
            if now < lowest:
                best, lowest = joint, now
    return best.point, scale * best.kernel, before, lowest


@dataclasses.dataclass(frozen=True)
class JointlyTuned:
    """A guide and a schedule that belong together.

    Attributes:
        guide: with the tuned last layer.
        schedule: with the tuned κ, λ and α.
        tuning: (before, after) on the tuning frames.
        held_out: likewise, on frames that nothing was chosen on; None if there are none.
    """

    guide: Guide
    schedule: Schedule
    tuning: tuple[dict[str, float], dict[str, float]]
    held_out: tuple[dict[str, float], dict[str, float]] | None


def tune_guide_and_schedule(
    bench: Workbench,
    guide: Guide,
    schedule: Schedule,
    factors: tuple[int, ...],
    frames: Sequence[int],
    holdout: Sequence[int] = (),
    *,
    iterations: int = ITERATIONS,
    seed: int = 0,
    report: Callable[[int, float], None] = lambda iteration, loss: None,
    expired: Callable[[], bool] = lambda: False,
) -> JointlyTuned:
    """`tune_jointly` on frames of a capture, with its effect on other frames.

    Args:
        bench: the capture, whose guide is `guide`.
        guide: whose last layer is tuned.
        schedule: to start from; its levels are among the factors.
        factors: downsampling factors, coarse to fine.
        frames: indices to tune on; those that see no surface are left out.
        holdout: indices that are only reported on.
        iterations: updates.
        seed: of the order of frames.
        report: called with each iteration and its loss.
        expired: asked before each iteration whether to stop.
    """
    cases, _ = bench.cases(frames, "tuning", progress=False)
    trunks = [guide.trunk(to_display(case.frame)) for case in cases]
    point, kernel, _, _ = tune_jointly(
        cases,
        trunks,
        guide.kernel,
        relaxed_of(schedule, factors),
        factors,
        iterations=iterations,
        seed=seed,
        report=report,
        expired=expired,
    )
    tuned, tuned_schedule = guide.with_kernel(kernel), point.schedule(factors, f"{schedule.name}-joint")
    compared = []
    for several in (cases, bench.cases(holdout, "held-out", progress=False)[0] if holdout else []):
        again = [dataclasses.replace(case, guide=tuned.features(to_display(case.frame))) for case in several]
        if several:
            before = scores(several, [refined_filter(case, schedule) for case in several])
            compared.append((before, scores(again, [refined_filter(case, tuned_schedule) for case in again])))
    return JointlyTuned(tuned, tuned_schedule, compared[0], compared[1] if len(compared) > 1 else None)


def tune_and_save(
    bench: Workbench,
    schedule: Schedule,
    estimator: ScheduleClock,
    frames: Sequence[int],
    holdout: Sequence[int],
    out: Path,
    monitor: RunMonitor,
    *,
    seed: int = 0,
) -> dict[str, Any]:
    """`tune_guide_and_schedule` of a run: writes `guide.safetensors` and `joint.json`, returns the record."""
    with tqdm(total=ITERATIONS, desc="guide and schedule", disable=not monitor.progress) as bar:

        def report(_: int, loss: float) -> None:
            bar.update()
            bar.set_postfix_str(f"loss {loss:.5f}", refresh=False)

        found = tune_guide_and_schedule(
            bench,
            check_joint(bench.guide, out),
            schedule,
            estimator.table.factors,
            frames,
            holdout,
            seed=seed,
            report=report,
            expired=monitor.expired,
        )
    time = estimator.measure([found.schedule], progress=False, again=True)[0]
    found.guide.save(out / "guide.safetensors")
    write_text(out / "joint.json", found.schedule.to_json() + "\n")
    compared = {"tuning": found.tuning} | ({} if found.held_out is None else {"held out": found.held_out})
    return {"schedule": schedule.name, "measured": dataclasses.asdict(time)} | compared


def check_joint(guide: FrameGuide, out: Path | None) -> Guide:
    """The guide, or `InputError` unless it has a layer to tune and there is a folder to write it to."""
    if not isinstance(guide, Guide):
        raise InputError(f"joint: the {guide.name} guide has no layer to tune; give --guide small or a file")
    if out is None:
        raise InputError("joint: needs a folder for the tuned guide; give out")
    return guide
