"""Time of a learned guide for a frame: ours against torch and ONNX Runtime running the same network.

    python -m experiments.guide_speed [--encoders small medium] [--sizes 256 512] [--features 64]
        [--repeats 30] [--out results/guide_speed]

Takes three minutes on two idle cores. Compares with torch, timm and segmentation-models-pytorch, and with the extra
`export-onnx`, where they are installed. All run with the same random weights on all cores of this process, on one
picture, in turns; the first call of each, in which ours is compiled, is kept apart. torch is given the picture
normalised already, once in its usual layout and once with channels last; ONNX Runtime runs what `hyjax export`
writes. The shipped network has `--features 16`. *half* is ours at half the picture's size, as `--guide small-half`.

Expect: the results agree to rounding. Measure on an idle machine: others' threads wait for each other by spinning,
so that anything else that runs costs them far more than ours. The processor time, of all cores together, depends
less on what else runs, but counts the spinning.
"""

import copy
import dataclasses
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Float

from experiments.blocks import Block, Plot, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.plotting import bars
from experiments.records import Row, machine, of_kind
from hyjax.export.graph import guide_graph
from hyjax.export.to_onnx import convert
from hyjax.guide import Guide, GuideNetwork, normalise
from hyjax.guide.choose import ReducedGuide
from hyjax.guide.weights import assign
from hyjax.tuning.calibration import check_repeats
from hyjax.util.clock import measure_each
from hyjax.util.errors import InputError

OURS, HALF, TORCH, CHANNELS_LAST, ONNX = "ours", "ours, half", "torch", "torch, channels last", "ONNX Runtime"
SMALLEST = 32


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    encoders: tuple[Literal["small", "medium"], ...] = ("small", "medium")
    """MobileNetV4-Conv of these sizes."""
    sizes: tuple[int, ...] = (256, 512)
    """Side lengths of square pictures."""
    features: int = 64
    """Of the guide; the network that comes with hyjax has 16."""
    repeats: int = 30
    seed: int = 0


@experiment("What a learned guide costs a frame")
def main(config: Config, start: Start) -> None:
    check_repeats(config.repeats)
    if bad := [size for size in config.sizes if size < SMALLEST]:
        raise InputError(f"sizes: a picture must be at least {SMALLEST} pixels wide, got {bad[0]}")
    results = start()
    for size_of_encoder in config.encoders:
        encoder = f"mobilenetv4_conv_{size_of_encoder}"
        network, theirs = same_networks(encoder, config.seed, config.features)
        guide = Guide(network)
        for size in config.sizes:
            picture = np.random.default_rng(config.seed).random((size, size, 3), np.float32)
            display = jnp.asarray(picture)
            calls: dict[str, Callable[[], Any]] = {
                OURS: lambda guide=guide, x=display: guide.features(x),
                HALF: lambda guide=guide, x=display: ReducedGuide(guide).features(x),
            }
            calls |= onnx_call(guide, picture)
            if theirs is not None:
                calls |= torch_calls(theirs, np.asarray(normalise(display)))
            jax.clear_caches()  # the first call shall contain the compilation
            processor: dict[str, list[float]] = {who: [] for who in calls}
            timed = {who: processor_timed(call, processor[who]) for who, call in calls.items()}
            times = measure_each(timed, config.repeats, progress=True)
            difference = None
            if theirs is not None:
                features = np.asarray(calls[OURS]() + last_bias(network))
                expected = calls[TORCH]()[0].permute(1, 2, 0).numpy()
                difference = float(np.abs(features - expected).max() / np.abs(expected).max())
            for who, taken in times.items():
                results.add(
                    kind="time", encoder=encoder, size=size, who=who, difference=difference, **taken,
                    features=config.features, processor_ms=1e3 * float(np.median(processor[who][1:])),
                    parameters=sum(leaf.size for leaf in jax.tree.leaves(nnx.state(network, nnx.Param))),
                )  # fmt: skip


def processor_timed(call: Callable[[], Any], seconds: list[float]) -> Callable[[], Any]:
    """The call, which also appends the processor time it takes."""

    def timed() -> Any:
        start = time.process_time()
        result = jax.block_until_ready(call())
        seconds.append(time.process_time() - start)
        return result

    return timed


def onnx_call(guide: Guide, picture: np.ndarray) -> dict[str, Callable[[], Any]]:
    """ONNX Runtime on what `hyjax export` writes; nothing where it is not installed."""
    try:
        run_graph = convert(guide_graph(guide, picture.shape[:2])).run
    except InputError as error:
        print(f"{main.name}: {error}", file=sys.stderr)
        return {}
    return {ONNX: lambda: run_graph({"display": picture})} if run_graph else {}


def last_bias(network: GuideNetwork) -> Float[Array, "f"]:
    """Bias of the last layer, which the network's features have on top of a guide's."""
    return network.segmentation_head[0].bias[...]


def same_networks(encoder: str, seed: int, features: int = 64) -> tuple[GuideNetwork, Any]:
    """Ours and torch's with the same random weights, in inference mode; None for torch's, see `torch_network`."""
    theirs = torch_network(encoder, seed, features)
    network = GuideNetwork(encoder, features, rngs=nnx.Rngs(seed))
    if theirs is not None:
        state = {name: tensor.numpy() for name, tensor in theirs.state_dict().items()}
        assign(network, {n: a for n, a in state.items() if not n.endswith("tracked")}, "torch")
    network.eval()
    return network, theirs


def torch_network(encoder: str, seed: int, features: int) -> Any:
    """smp's Unet with random weights, in inference mode; None, and a word on stderr, where it is not installed."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import torch

            _import_torchvision(torch)
            import segmentation_models_pytorch as smp
    except ImportError as error:
        print(f"{main.name}: ours is timed alone: {error.name} is not installed", file=sys.stderr)
        return None
    torch.manual_seed(seed)
    return smp.Unet(f"tu-{encoder}", encoder_weights=None, classes=features).eval()


def _import_torchvision(torch: Any) -> None:
    """timm wants it. Its wheels for other devices lack operators, which these networks do without."""
    try:
        import torchvision
    except RuntimeError:
        for name in [name for name in sys.modules if name.split(".")[0] == "torchvision"]:
            del sys.modules[name]
        for name in ("nms", "qnms"):
            torch.library.define(f"torchvision::{name}", "(Tensor a, Tensor b, float c) -> Tensor")
        import torchvision  # noqa: F401


def torch_calls(network: Any, normalised: np.ndarray) -> dict[str, Callable[[], Any]]:
    """The network on one picture in both of torch's layouts."""
    import torch

    picture = torch.tensor(normalised).permute(2, 0, 1)[None].contiguous()
    last = copy.deepcopy(network).to(memory_format=torch.channels_last)
    picture_last = picture.to(memory_format=torch.channels_last)

    def call(network: Any, picture: Any) -> Any:
        with torch.inference_mode():
            return network(picture)

    return {TORCH: lambda: call(network, picture), CHANNELS_LAST: lambda: call(last, picture_last)}


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and figure from the rows."""
    times = of_kind(rows, "time")
    if not times:
        return ["Nothing has been timed yet."]
    lines = [
        [
            f"{row['encoder'].removeprefix('mobilenetv4_conv_')}, {row['size']}²",
            row["who"],
            f"{row['first_ms']:.0f}",
            f"{row['median_ms']:.1f}",
            f"{row['p95_ms']:.1f}",
            f"{row['processor_ms']:.0f}",
        ]
        for row in times
    ]
    differences = [row["difference"] for row in times if row["difference"] is not None]
    agreement = f"; results differ by at most {max(differences):.0e} of the largest" if differences else ""
    caption = f"A guide of {times[0]['features']} features for one picture; {machine(times[0])}{agreement}."
    medians = {f"{line[0]}, {line[1]}": row["median_ms"] for line, row in zip(lines, times)}
    figure = bars(medians, [(label, row["p95_ms"]) for label, row in zip(medians, times)], "milliseconds")
    return [
        Table(
            caption,
            ["network, picture", "run by", "first call ms", "median ms", "p95 ms", "processor ms"],
            lines,
            names=2,
        ),
        Plot(main.name, "Milliseconds a picture: median (bar) and 95th percentile (tick).", figure),
    ]


if __name__ == "__main__":
    run(main)
