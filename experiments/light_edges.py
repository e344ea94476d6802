"""Network that tells light from paint in the differences between a photo's pixels, trained on generated rooms.

    python -m experiments.light_edges [--rooms 202] [--steps 9000] [--out DIR]

Each view of a generated room has its photo, which went through a random camera, and the light that fell on each
pixel. The estimate that the network is given is that light, blurred evenly or along the surface, with an error that
is slow over the picture and another contrast; its surface is displaced, blurred, noisy or missing. Minimised are
the root mean square error of log E after `hyjax.light.light_edges.corrected`, and that of its differences.

Writes `light_edges.safetensors`, which is `hyjax.guide.edge_weights.WEIGHTS_FILE`. Rooms are kept in the cache.
Takes half an hour and more on two cores.

Expect: on rooms held out, an error of log E a tenth below the estimate's where the whole correction is taken; the
default takes half. Judge it on real pairs by `experiments.real`.
"""

import dataclasses
import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import safetensors.numpy
from jaxtyping import Array, Float
from tqdm import tqdm

from experiments.blocks import Block, Picture, Plot, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.plotting import panels
from experiments.records import Row, of_kind
from hyjax.core.stencil import Edges, gradient
from hyjax.light.color import to_display, to_linear
from hyjax.light.light_edges import FEATURES, FIDELITY, LEAST_LIGHT, corrected, edge_features, light_shares
from hyjax.pairs.generated_rooms import VERSION
from hyjax.synthetic.random_room import make_random_room, photograph
from hyjax.util.cache import Arrays, cache_folder, cached_arrays
from hyjax.util.contact_sheet import write_contact_sheet
from hyjax.util.errors import InputError
from hyjax.util.extras import optional_module
from hyjax.util.files import atomic_write

SEED, SIZE, VIEWS, CROP, BATCH = 3, 256, 6, 128, 8
"""Seed of the rooms, side of a view in pixels, views a room, side of a crop, and crops a step."""
WIDTHS = (16, 24, 40)
"""Channels of the network at each scale."""
RATE, WARM_UP = 3e-3, 100
EDGE_WEIGHT, EDGE_SCALE, SHARP = 0.3, 0.03, 0.1
"""Weight of the differences' error, its unit, and the size from which errors count by their amount alone."""
LARGEST_DIFFERENCE = 2.0
"""Largest difference of log E between neighbouring pixels that is asked for."""
FIDELITIES = (1e-3, 1.6e-2)
"""Range of α in training."""
BURNT = 250
"""Value of a byte from which the photo tells nothing."""
Batch = tuple[Float[Array, "b h w ..."], ...]
SHEET = ("photo", "estimate", "with light edges", "true light", "share of light")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(RunConfig):
    rooms: int = 202
    """Rooms to train on; as many again by a tenth are held out."""
    steps: int = 9000
    """Steps of the training."""


@experiment("Light told from paint, on generated rooms", "held out")
def main(config: Config, start: Start) -> None:
    if config.rooms < 1 or config.steps <= WARM_UP:
        raise InputError(f"rooms, steps: need a room and more than {WARM_UP} steps")
    _cv2()  # which is missed before the rooms are made, not after
    results = start()
    held = max(1, config.rooms // 10)
    rooms = [_room(number) for number in tqdm(range(config.rooms + held), unit="room")]
    own, others = rooms[: config.rooms], rooms[config.rooms :]
    weights = _initial(jax.random.key(0))
    optimiser = optax.chain(
        optax.clip_by_global_norm(1.0),
        optax.adamw(optax.warmup_cosine_decay_schedule(0.0, RATE, WARM_UP, config.steps, 1e-5), weight_decay=1e-4),
    )

    @jax.jit
    def step(weights: Any, state: Any, batch: Batch, fidelity: float) -> tuple[Any, Any, Array]:
        error, slope = jax.value_and_grad(lambda w: _errors(w, batch, fidelity)[0])(weights)
        change, state = optimiser.update(slope, state, weights)
        return optax.apply_updates(weights, change), state, error

    state, rng, recent = optimiser.init(weights), np.random.default_rng(0), []
    for number in tqdm(range(1, config.steps + 1), unit="step"):
        fidelity = float(np.exp(rng.uniform(*np.log(FIDELITIES))))
        weights, state, error = step(weights, state, _batch(rng, own), np.float32(fidelity))
        recent.append(float(error))
        if number % 100 == 0:
            results.add(kind="step", step=number, error=float(np.mean(recent)))
            recent.clear()
    with atomic_write(results.out / "light_edges.safetensors") as temporary:
        temporary.write_bytes(safetensors.numpy.save({k: np.asarray(v, np.float16) for k, v in weights.items()}))
    judge, rng = jax.jit(_errors), np.random.default_rng(1)
    for room in tqdm(others, unit="room"):
        errors = np.array([judge(weights, _batch(rng, [room]), np.float32(FIDELITY))[1] for _ in range(VIEWS)])
        names = ("difference", "difference_before", "log_light", "log_light_before")
        results.add(kind="held out", **dict(zip(names, errors.mean(axis=0).tolist())))
    write_contact_sheet(results.out / "held_out.png", _sheet(weights, others), SHEET)


def _room(number: int) -> Arrays:
    """Views of a room: bytes of the photo, log light of its brightness, normals × 127, depth."""

    def make() -> Arrays:
        room = make_random_room(SEED, number)
        shots = [photograph(room, view, SIZE) for view in range(VIEWS)]
        return {
            "image": np.stack([np.round(255 * s.image).astype(np.uint8) for s in shots]),
            "light": np.stack([_log_light(s.light, s.depth > 0) for s in shots]).astype(np.float16),
            "normal": np.stack([np.round(127 * s.normal).astype(np.int8) for s in shots]),
            "depth": np.stack([s.depth for s in shots]).astype(np.float16),
        }

    return cached_arrays(
        cache_folder() / f"lit-rooms-v{VERSION}-{SEED}-{SIZE}x{VIEWS}" / f"{number:05d}.npz", dict, make
    )


def _log_light(light: Float[np.ndarray, "h w 3"], hit: np.ndarray) -> Float[np.ndarray, "h w"]:
    """Mean of the channels' logarithms, even where there is no surface, and without the darkest hundredth."""
    log = np.log(np.maximum(light, 1e-6)).mean(axis=-1)
    log = np.where(hit, log, log[hit].mean() if hit.any() else 0.0)
    return np.maximum(log, np.percentile(log, 1) - 1)


def _batch(rng: np.random.Generator, rooms: list[Arrays]) -> Batch:
    """Crops of views: log photo, estimate, normals, depth, true light, and whether a pixel counts."""
    drawn = [_crop(rng, rooms[rng.integers(len(rooms))]) for _ in range(BATCH)]
    return tuple(jnp.stack(parts) for parts in zip(*drawn, strict=True))


def _crop(rng: np.random.Generator, room: Arrays) -> tuple[Float[np.ndarray, "h w ..."], ...]:
    view, (y, x) = rng.integers(VIEWS), rng.integers(SIZE - CROP + 1, size=2)
    part = np.s_[y : y + CROP, x : x + CROP]
    image, depth, light = room["image"][view][part], room["depth"][view], room["light"][view].astype(np.float32)
    estimate = _estimate(rng, light, room["normal"][view].astype(np.float32) / 127)[part] + _slow(rng)
    normal, seen = _scanned(rng, room["normal"][view], depth, part)
    valid = (depth[part] > 0) & (image.max(axis=-1) < BURNT)
    bright = _linear()[image] * np.float32(rng.uniform(0.6, 1.0))
    parts = [np.log(np.maximum(bright, LEAST_LIGHT)), estimate, normal, seen, light[part], valid]
    if rng.random() < 0.5:
        parts = [p[:, ::-1] for p in parts]
        parts[2] = parts[2] * (-1, 1, 1)
    return tuple(np.ascontiguousarray(p, np.float32) for p in parts)


def _estimate(
    rng: np.random.Generator, light: Float[np.ndarray, "h w"], normal: Float[np.ndarray, "h w 3"]
) -> Float[np.ndarray, "h w"]:
    """Light as an estimate on a scan has it: blurred, often not across creases, with another contrast."""
    kind = rng.random()
    if kind < 0.15:
        return np.full_like(light, light.mean())
    if kind < 0.55:
        blurred = _blurred(light, np.exp(rng.uniform(*np.log((2, 24)))))
    else:
        reach, sharpness = int(rng.integers(4, 28)), float(np.exp(rng.uniform(*np.log((0.003, 0.1)))))
        blurred = _blurred(_cv2().ximgproc.guidedFilter(normal, light, reach, sharpness), rng.uniform(0.5, 2.5))
    mean = blurred.mean()
    return mean + (blurred - mean) * np.float32(rng.uniform(0.6, 1.2))


def _slow(rng: np.random.Generator) -> Float[np.ndarray, "h w"]:
    """Error of an estimate that is slow over the picture."""
    count = max(2, int(CROP / rng.uniform(30, 100))) + 2
    noise = rng.normal(size=(count, count)).astype(np.float32) * np.float32(rng.uniform(0, 0.35))
    slow: np.ndarray = _cv2().resize(noise, (CROP, CROP), interpolation=_cv2().INTER_CUBIC)
    return slow


def _scanned(
    rng: np.random.Generator, normal: np.ndarray, depth: np.ndarray, part: Any
) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]]:
    """Normals and depth of a scan: displaced, blurred, noisy, or missing."""
    shift = rng.integers(-3, 4, 2)
    normal, depth = (np.roll(x, shift, (0, 1))[part].astype(np.float32) for x in (normal, depth))
    depth = np.where(depth > 0, depth, 1)
    normal = normal / 127
    if rng.random() < 0.7:
        normal = _blurred(normal, rng.uniform(0.3, 3))
    if rng.random() < 0.5:
        noise = rng.normal(size=normal.shape).astype(np.float32)
        normal = normal + np.float32(rng.uniform(0, 0.75)) * _blurred(noise, 1.5)
    return (normal if rng.random() < 0.75 else 0 * normal), (depth if rng.random() < 0.75 else 0 * depth + 1)


def _blurred(picture: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian blur; a wide one at a quarter of the size."""
    cv2, quarter = _cv2(), (picture.shape[1] // 4, picture.shape[0] // 4)
    if sigma < 5:
        return np.asarray(cv2.GaussianBlur(picture, (0, 0), float(sigma)))
    small = cv2.GaussianBlur(cv2.resize(picture, quarter, interpolation=cv2.INTER_AREA), (0, 0), float(sigma) / 4)
    return np.asarray(cv2.resize(small, picture.shape[1::-1], interpolation=cv2.INTER_LINEAR))


@functools.cache
def _linear() -> Float[np.ndarray, "256"]:
    """Linear light of each value of a byte."""
    return np.asarray(to_linear(np.arange(256) / 255), np.float32)


def _cv2() -> Any:
    return optional_module("cv2", "experiments", "light_edges")


def _initial(key: Array) -> dict[str, Array]:
    """Weights before the training; the last layer's are small."""
    sizes = {"stem": (3, 4 * FEATURES, WIDTHS[0]), "head": (1, WIDTHS[0], 8)}
    for k, width in enumerate(WIDTHS):
        sizes[f"block{k}"] = (3, width, width)
        if k + 1 < len(WIDTHS):
            sizes |= {
                f"down{k}": (3, width, WIDTHS[k + 1]),
                f"up{k}": (1, WIDTHS[k + 1], width),
                f"merge{k}": (3, width, width),
            }
    weights: dict[str, Array] = {}
    for (name, (side, inputs, outputs)), own in zip(sizes.items(), jax.random.split(key, len(sizes)), strict=True):
        scale = np.sqrt(2 / (side**2 * inputs)) * (0.1 if name == "head" else 1.0)
        weights[f"{name}.kernel"] = scale * jax.random.normal(own, (side, side, inputs, outputs))
        weights[f"{name}.bias"] = jnp.zeros(outputs)
    return weights


def _sharpened(weights: Any, batch: Batch, fidelity: Any) -> tuple[Array, Edges]:
    """Log light after the correction, and the shares."""
    photo, estimate, normal, depth, *_ = batch
    shares = light_shares(weights, edge_features(photo, estimate, normal, depth))
    return estimate + corrected(photo.mean(axis=-1), estimate, shares, fidelity), shares


def _errors(weights: Any, batch: Batch, fidelity: Any) -> tuple[Array, Float[Array, "4"]]:
    """Loss, and errors of differences and of log light, each after and before the correction."""
    photo, estimate, *_, light, valid = batch
    sharp, shares = _sharpened(weights, batch, fidelity)
    both = (valid[:, 1:] * valid[:, :-1], valid[:, :, 1:] * valid[:, :, :-1])
    true = [jnp.clip(d, -LARGEST_DIFFERENCE, LARGEST_DIFFERENCE) for d in gradient(light)]
    before = gradient(estimate)
    after = [e + s * (i - e) for e, s, i in zip(before, shares, gradient(photo.mean(axis=-1)), strict=True)]

    def difference(edges: Any) -> Array:
        off = [jnp.sqrt((e - t) ** 2 + SHARP**2) - SHARP for e, t in zip(edges, true, strict=True)]
        down, right = ((o * b).sum() / b.sum() for o, b in zip(off, both, strict=True))
        return (down + right) / EDGE_SCALE

    def whole(log: Array) -> Array:
        return jnp.sqrt(((log - light) ** 2 * valid).sum() / valid.sum())

    errors = jnp.stack([difference(after), difference(before), whole(sharp), whole(estimate)])
    return errors[2] + EDGE_WEIGHT * errors[0], errors


def _sheet(weights: Any, rooms: list[Arrays]) -> list[tuple[str, list[np.ndarray]]]:
    """Lines of the sheet: a crop of some rooms held out."""
    rng, lines = np.random.default_rng(2), []
    for number, room in enumerate(rooms[:6]):
        batch = tuple(part[:1] for part in _batch(rng, [room]))
        sharp, shares = _sharpened(weights, batch, FIDELITY)
        light = np.asarray(batch[4][0])
        low, high = np.percentile(light, (1, 99))
        fields = [np.asarray(x[0]) for x in (batch[1], sharp, batch[4])]
        gray = [np.clip((f - low) / max(high - low, 1e-6), 0, 1) for f in fields]
        gray.append(np.pad(np.asarray(shares[0][0]), ((0, 1), (0, 0))))
        photo = np.asarray(to_display(jnp.exp(batch[0][0])))
        lines.append((f"room {number}", [photo, *(np.repeat(g[..., None], 3, axis=-1) for g in gray)]))
    return lines


def blocks(rows: list[Row], folder: Path) -> list[Block]:
    """Curve, table and sheet from the rows."""
    steps, held = of_kind(rows, "step"), of_kind(rows, "held out")
    curve = {"training": ([row["step"] for row in steps], [row["error"] for row in steps])}
    lines = []
    for name, label in (("log_light", "log E"), ("difference", "its differences")):
        after, before = (np.array([row[key] for row in held]) for key in (name, f"{name}_before"))
        lines.append([label, *(f"{np.median(v):.3f}" for v in (before, after, after / before))])
    caption = (
        f"Errors on {len(held)} generated rooms held out, medians: root mean square of log E; differences between "
        f"neighbouring pixels, robust, in units of {EDGE_SCALE}."
    )
    return [
        Table(caption, ["", "estimate", "with light edges", "ratio"], lines),
        Plot("training", "Loss of the training.", panels({"loss": curve}, "-", xlabel="step")),
        Picture(folder / "held_out.png", "Crops of rooms held out."),
    ]


if __name__ == "__main__":
    run(main)
