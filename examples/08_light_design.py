"""Light design by gradients: lamps are moved, dimmed and coloured until the frame looks like a target picture.

    python examples/08_light_design.py [SIZE]

Picture: the frame under the start lamps; under the lamps that were found; the target picture.
"""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax

import hyjax

SIZE = sys.argv[1] if len(sys.argv) > 1 else "320x240"
OUT = Path("out/examples/08_light_design.png")
STEPS, REFERENCE_LUX = 150, 25.0

view = hyjax.Scene.open(hyjax.SceneSettings(size=SIZE)).view(8)
schedule = hyjax.Schedule.preset("hyjax")
white, warm = jnp.ones(3), jnp.array([1.0, 0.6, 0.25])


def picture(lamps: list[hyjax.Light]) -> jax.Array:
    """The frame under these lamps, linear: shading, repair and product, all differentiable (no shadows here)."""
    lux = hyjax.shade_each(view.gbuffer, lamps)
    refined = hyjax.cascade_known(lux, view.gbuffer.hit[..., None], view.display, schedule)
    return hyjax.composite(hyjax.colored(refined, lamps) / REFERENCE_LUX, view.frame)


def lamps_of(parameters: dict[str, jax.Array]) -> list[hyjax.Light]:
    """Two bulbs and a dim ambient light. Flux and colours stay positive."""
    flux, color = 100.0 * jnp.exp(parameters["log_flux"]), jnp.exp(parameters["log_color"])
    bulbs = [hyjax.PointLight(parameters["position"][i], flux[i], color[i]) for i in range(2)]
    return [*bulbs, hyjax.AmbientLight(jnp.float32(1.0), white)]


wanted = [
    hyjax.PointLight(jnp.array([1.0, 0.6, 1.6]), jnp.float32(300.0), warm),
    hyjax.PointLight(jnp.array([1.9, 1.9, 1.3]), jnp.float32(200.0), jnp.array([0.25, 0.5, 1.0])),
    hyjax.AmbientLight(jnp.float32(1.0), white),
]
target = picture(wanted)
parameters = {
    "position": jnp.array([[1.3, 1.1, 1.9], [1.6, 1.4, 1.9]]),
    "log_flux": jnp.ones(2),
    "log_color": jnp.zeros((2, 3)),
}
start, adam = picture(lamps_of(parameters)), optax.adam(0.05)


@jax.jit
def update(
    parameters: dict[str, jax.Array], state: optax.OptState
) -> tuple[dict[str, jax.Array], optax.OptState, jax.Array]:
    difference = lambda p: jnp.mean((jnp.sqrt(picture(lamps_of(p)) + 1e-4) - jnp.sqrt(target + 1e-4)) ** 2)  # noqa: E731
    loss, gradient = jax.value_and_grad(difference)(parameters)
    change, state = adam.update(gradient, state)
    return optax.apply_updates(parameters, change), state, loss


state = adam.init(parameters)
for step in range(STEPS):
    parameters, state, loss = update(parameters, state)
    if step % 30 == 0:
        print(f"step {step}: loss {float(loss):.5f}")
for found, known in zip(lamps_of(parameters)[:2], wanted):
    off = np.linalg.norm(np.asarray(found.position) - np.asarray(known.position))
    print(f"a lamp of {float(found.luminous_flux * found.color.mean()):.0f} lm, {off:.2f} m off the target's")

OUT.parent.mkdir(parents=True, exist_ok=True)
found = picture(lamps_of(parameters))
hyjax.write_png(OUT, np.concatenate([hyjax.to_display(x) for x in (start, found, target)], axis=1))
print(
    f"{OUT}: {float(hyjax.metrics.psnr(hyjax.to_display(found), hyjax.to_display(target))):.1f} dB from the target"
)
