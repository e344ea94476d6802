"""Refinement of a configuration's numbers by the gradient of the loss through the whole frame.

κ, λ and α of both cascades, the exponent of the photo's light and the gain of bounces move together (Adam, on
logarithms); which levels take how many steps, and all else that is discrete, stays.
"""

import dataclasses
import functools
from collections.abc import Callable, Collection, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from hyjax.choices.table import CHOICES
from hyjax.configuration import Configuration
from hyjax.core.step_size import DEFAULT_LAM
from hyjax.scene.relighter import LitFrame, refined_picture
from hyjax.tuning.cascade_numbers import with_numbers as with_cascade_numbers
from hyjax.tuning.evaluation import FrameCase, Judge, padded
from hyjax.tuning.scene import Target
from hyjax.util.quick_programs import cascade_options

ITERATIONS = 12
LEARNING_RATE = 0.3
"""Rate of Adam, in units of a number's logarithm."""
Numbers = dict[str, Float[Array, "*l"]]
"""Each number, or one for each level."""


def numbers_of(configuration: Configuration, *, levels: bool) -> Numbers:
    """Numbers of a configuration.

    Args:
        levels: κ, λ and α of each level instead of their geometric means.
    """
    schedule, shadow, light = configuration.schedule, configuration.shadow_schedule, configuration.light
    found: dict[str, list[float]] = {
        "kappa": [float(np.asarray(level.kappa)) for level in schedule.levels],
        "lam": [
            float(np.mean(np.asarray(level.step_sizes))) if level.steps else DEFAULT_LAM
            for level in schedule.levels
        ],
    }
    if all(level.fidelity is not None for level in schedule.levels):
        found["fidelity"] = [max(float(np.asarray(level.fidelity)), 0.01) for level in schedule.levels]
    if any(level.steps for level in shadow.levels):
        found["shadow_kappa"] = [float(np.asarray(level.kappa)) for level in shadow.levels]
    if configuration.mode == "linear" and light.photo_light == "divided":
        found["photo_exponent"] = [light.photo_exponent]
        if light.bounces:
            found["bounce_gain"] = [light.bounce_gain]
    single = ("photo_exponent", "bounce_gain")
    return {
        name: jnp.asarray(values if levels and name not in single else np.exp(np.mean(np.log(values))), jnp.float32)
        for name, values in found.items()
    }


def with_numbers(configuration: Configuration, numbers: Mapping[str, Array]) -> Configuration:
    """The configuration with other numbers of its cascades; they may be traced."""
    cascade_numbers = {name: numbers.get(name) for name in ("kappa", "lam", "fidelity")}
    return dataclasses.replace(
        configuration,
        schedule=with_cascade_numbers(configuration.schedule, **cascade_numbers),
        shadow_schedule=with_cascade_numbers(configuration.shadow_schedule, kappa=numbers.get("shadow_kappa")),
    )


def settled(configuration: Configuration, numbers: Mapping[str, Array]) -> Configuration:
    """`with_numbers` of known numbers, those of the light among them."""
    changed = with_numbers(configuration, numbers)
    light = configuration.light
    for name in ("photo_exponent", "bounce_gain"):
        if name in numbers:
            light = light.replace(**{name: round(float(numbers[name]), 4)})
    return dataclasses.replace(changed, light=light).check()


def refine_numbers(
    configuration: Configuration,
    judge: Judge,
    cases: Sequence[FrameCase],
    *,
    levels: bool = False,
    held: Collection[str] = (),
    iterations: int = ITERATIONS,
    report: Callable[[int, float], None] = lambda iteration, loss: None,
    expired: Callable[[], bool] = lambda: False,
) -> Configuration:
    """The configuration with the numbers that were best on cases.

    Args:
        cases: all of them are looked at in each iteration.
        levels: whether each level has its own κ, λ and α.
        held: numbers that stay.
        report: called with each iteration and its loss, relative to the first.
        expired: asked before each iteration.
    """
    lit = [lit_case(configuration, judge, case) for case in cases]
    gains = [judge.loss.gains(np.asarray(refined_picture(frame, judged)), target) for frame, target, judged in lit]
    most = max(frame.shaded.illuminance.shape[-1] for frame, _, _ in lit)
    alike = [padded(frame, most) for frame, _, _ in lit]
    start = {n: value for n, value in numbers_of(configuration, levels=levels).items() if n not in held}
    boxes = {name: np.log(CHOICES[name].tried.values) for name in start}  # type: ignore[union-attr]

    @functools.partial(jax.jit, compiler_options=cascade_options())
    def slope(
        logs: Numbers, frame: LitFrame, gains: Array, picture: Array, valid: Array
    ) -> tuple[tuple[Array, Array], Numbers]:
        def value(logs: Numbers) -> tuple[Array, Array]:
            image = _picture(logs, start, configuration, frame)
            return judge.loss.value(image, gains, picture, valid), image

        return jax.value_and_grad(value, has_aux=True)(logs)

    logs = {name: jnp.log(value) for name, value in start.items()}
    optimizer = optax.adam(
        optax.cosine_decay_schedule(LEARNING_RATE, max(iterations, 1), alpha=0.2), b1=0.7, b2=0.9
    )
    state, best, lowest = optimizer.init(logs), logs, np.inf
    first: Float[np.ndarray, n] | None = None
    for iteration in range(iterations + 1):
        if expired():
            break
        losses, slopes = [], []
        for index, (frame, (_, target, _)) in enumerate(zip(alike, lit, strict=True)):
            (loss, image), change = slope(logs, frame, gains[index], target.picture, target.valid)
            gains[index] = judge.loss.gains(np.asarray(image), target)  # for the next time
            losses.append(float(loss))
            slopes.append(change)
        first = np.maximum(losses, 1e-9) if first is None else first
        shares = 1.0 / first / len(lit)
        relative = float(shares @ losses)
        report(iteration, relative)
        if relative < lowest:
            best, lowest = logs, relative
        total = {name: sum(w * slope_of[name] for w, slope_of in zip(shares, slopes)) for name in logs}
        updates, state = optimizer.update(total, state)
        logs = {name: jnp.clip(value, *boxes[name]) for name, value in optax.apply_updates(logs, updates).items()}
    return settled(configuration, {name: jnp.exp(value) for name, value in best.items()})


def lit_case(configuration: Configuration, judge: Judge, case: FrameCase) -> tuple[LitFrame, Target, Configuration]:
    scene = judge.scenes[case[0]]
    judged = scene.judged(configuration)
    return scene.relighter(case[1], judged).lit(case[2]), scene.target(case[1], case[2]), judged


def _picture(logs: Numbers, start: Numbers, configuration: Configuration, lit: LitFrame) -> Float[Array, "h w 3"]:
    numbers, shaded = {name: jnp.exp(value) for name, value in logs.items()}, lit.shaded
    if "photo_exponent" in numbers and shaded.photo_light is not None:
        more = numbers["photo_exponent"] / start["photo_exponent"]
        light, has_light = shaded.photo_light, shaded.photo_light > 0
        shaded = dataclasses.replace(
            shaded, photo_light=jnp.where(has_light, jnp.where(has_light, light, 1.0) ** more, light)
        )
    if "bounce_gain" in numbers and shaded.bounced is not None:
        shaded = dataclasses.replace(shaded, bounced=shaded.bounced * numbers["bounce_gain"] / start["bounce_gain"])
    return refined_picture(dataclasses.replace(lit, shaded=shaded), with_numbers(configuration, numbers))
