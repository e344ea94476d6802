"""Gradient of κ and λ: a schedule that learns what an accurate surface's light looks like.

    python examples/07_gradient_of_a_schedule.py [SIZE]

Picture: the scan's raw filter; refined by the start schedule; by the learned one; the accurate surface's filter.
"""

import dataclasses
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax

import hyjax

SIZE = sys.argv[1] if len(sys.argv) > 1 else "320x240"
OUT = Path("out/examples/07_gradient_of_a_schedule.png")
STEPS, RATE = 30, 0.1

scan, true = (hyjax.Scene.open(hyjax.SceneSettings(size=SIZE, mesh=mesh)) for mesh in ("scan", "true"))
view, setup = scan.view(8), scan.lights("two-colors")
raw, target = (hyjax.shade(s.view(8).gbuffer, setup.lights) / setup.reference_lux for s in (scan, true))
known, start = view.gbuffer.hit[..., None], hyjax.Schedule.preset("hyjax", kappa=1.0)


def schedule_of(parameters: dict[str, jax.Array]) -> hyjax.Schedule:
    """κ > 0 and 0 < λ < 1/4 hold for every value of the parameters, one of each for every level."""
    kappas, lams = jnp.exp(parameters["log_kappa"]), 0.25 * jax.nn.sigmoid(parameters["logit_4_lambda"])
    levels = [
        dataclasses.replace(level, kappa=kappa, step_sizes=jnp.full(level.steps, lam))
        for level, kappa, lam in zip(start.levels, kappas, lams)
    ]
    return dataclasses.replace(start, levels=tuple(levels), name="learned")


@jax.jit
@jax.value_and_grad
def loss(parameters: dict[str, jax.Array]) -> jax.Array:
    refined = hyjax.cascade_known(raw, known, view.display, schedule_of(parameters))
    return jnp.mean((hyjax.to_display(refined) - hyjax.to_display(target)) ** 2)


parameters = {"log_kappa": jnp.zeros(3), "logit_4_lambda": jnp.ones(3)}
adam = optax.adam(RATE)
state = adam.init(parameters)
for step in range(STEPS):
    value, gradient = loss(parameters)
    if step % 10 == 0:
        print(f"step {step}: loss {float(value):.5f}")
    change, state = adam.update(gradient, state)
    parameters = optax.apply_updates(parameters, change)
learned = schedule_of(parameters)
print(f"last: {float(loss(parameters)[0]):.5f}\n{learned}")

OUT.parent.mkdir(parents=True, exist_ok=True)
refined = [hyjax.cascade_known(raw, known, view.display, schedule) for schedule in (start, learned)]
hyjax.write_png(OUT, np.concatenate([hyjax.to_display(x) for x in (raw, *refined, target)], axis=1))
