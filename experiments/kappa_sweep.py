"""Which κ, pooling and norm: fidelity of the relit frame on tuning frames, and of the winner on held-out frames.

    python -m experiments.kappa_sweep [--capture PATH] [--out results/kappa_sweep]

Takes about a minute on two cores, once the capture's meshes are made. The rough mesh (the capture's simulated scan)
is relit by two coloured lights and compared with the frame times the raw filter of the accurate mesh (the built-in
room's true one, or the capture's fusion at 2 cm) under the same lights: PSNR of display values where the accurate
mesh has a surface. The last quarter of the capture is held out: nothing is chosen on those frames.

Expect: our mode above the paper's, and the paper's above the bare scan, by one to two decibels each. The curves are
flat around their tops. A filter of the mean colour is in the table because it, too, has no edges to get wrong.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

import hyjax
from experiments.blocks import Block, Plot, Table, write_blocks
from experiments.command import run
from experiments.plotting import new_figure
from experiments.records import Results, Row, of_kind
from hyjax.data.capture import Capture
from hyjax.data.frames import fit
from hyjax.data.light_setups import named_setup, survey_capture
from hyjax.data.open import open_capture
from hyjax.data.room import load_room
from hyjax.data.surfaces import surface_of
from hyjax.scene.raycast import RayCaster
from hyjax.scene.shadow_caster import cast_shadow_maps
from hyjax.schedule import PRESETS, Schedule

NAME = "kappa_sweep"
TITLE = "Fidelity against κ, pooling and norm"
KAPPAS = (0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.4)
VARIANTS = (
    ("paper", "edges", "l2"),
    ("hyjax", "edges", "l2"),
    ("hyjax", "guide", "l2"),
    ("hyjax", "edges", "mean_abs"),
)
BASELINES = ("bare scan", "mean colour")


@dataclasses.dataclass(frozen=True)
class Config:
    capture: Path | None = None
    """Default: the built-in room."""
    schedule: str = "paper-80"
    frames: int = 4
    """How many tuning frames, and as many held out."""
    out: Path = Path("results/kappa_sweep")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Case:
    """One frame with what it takes to relight and to judge it."""

    linear: Any
    guide: Any
    gbuffer: Any
    target: Any
    valid: Any


class Bench:
    """The two meshes under the same lights."""

    def __init__(self, capture: Capture) -> None:
        accurate = (
            surface_of(capture, "true") if capture.name == "room" else surface_of(capture, "fused", voxel=0.02)
        )
        self.capture = capture
        self.rough, self.accurate = RayCaster(surface_of(capture, "scan")[1]), RayCaster(accurate[1])
        self.setup = named_setup("two-colors", survey_capture(self.accurate, capture))
        self.maps = cast_shadow_maps(self.rough, self.setup.lights)
        self.accurate_maps = cast_shadow_maps(self.accurate, self.setup.lights)

    def case(self, index: int) -> Case:
        frame = fit(self.capture[index], (512, 512))
        guide = jnp.asarray(frame.image)
        linear = hyjax.to_linear(guide)
        truth = self.accurate.gbuffer(frame.camera)
        target = self._relight(linear, guide, truth, Schedule.preset("naive-50"), self.accurate_maps).unrefined
        return Case(linear, guide, self.rough.gbuffer(frame.camera), hyjax.to_display(target), truth.hit)

    def relight(self, case: Case, schedule: Schedule, mode: str = "hyjax") -> hyjax.Relit:
        return self._relight(case.linear, case.guide, case.gbuffer, schedule, self.maps, mode)

    def _relight(
        self, linear: Any, guide: Any, gbuffer: Any, schedule: Schedule, maps: Any, mode: Any = "hyjax"
    ) -> Any:
        kappa = float(schedule.levels[-1].kappa)
        shadow = dataclasses.replace(Schedule.preset("shadow", kappa=kappa), norm=schedule.norm)
        return hyjax.relight(
            linear,
            gbuffer,
            self.setup.lights,
            guide,
            schedule,
            shadow_maps=maps,
            shadow_schedule=shadow,
            reference_lux=self.setup.reference_lux,
            mode=mode,
        )


@jax.jit
def psnr(image: Any, case: Case) -> Any:
    """PSNR in dB of a linear picture's display values against the target, where there is truth."""
    squared = jnp.mean((hyjax.to_display(image) - case.target) ** 2, axis=-1)
    return -10.0 * jnp.log10(jnp.sum(squared * case.valid) / jnp.sum(case.valid))


def mean_color(case: Case, relit: hyjax.Relit) -> Any:
    """The frame times one colour: the mean of the raw filter where the scan has a surface."""
    return case.linear * jnp.sum(relit.shading, axis=(0, 1)) / jnp.sum(case.gbuffer.hit)


def main(config: Config) -> None:
    capture = load_room() if config.capture is None else open_capture(config.capture)
    results = Results(config.out, NAME, config)
    bench = Bench(capture)
    count = len(capture)
    tuning = np.linspace(0, 0.75 * count - 1, config.frames).astype(int)
    held_out = np.linspace(0.75 * count, count - 1, config.frames).round().astype(int)

    def score(split: str, index: int, method: str, image: Any, case: Case, kappa: float | None = None) -> None:
        results.add(
            kind="score",
            capture=capture.name,
            split=split,
            frame=capture[index].name,
            method=method,
            kappa=kappa,
            psnr=float(psnr(image, case)),
        )

    cases = {int(index): bench.case(int(index)) for index in (*tuning, *held_out)}
    variants = {", ".join(variant): variant for variant in VARIANTS}
    for name, (mode, pooling, norm) in tqdm(variants.items(), desc="sweep"):
        for kappa in KAPPAS:
            schedule = Schedule.uniform(PRESETS[config.schedule], kappa=kappa, pooling=pooling, norm=norm)
            for index in tuning:
                case = cases[index]
                score("tuning", index, name, bench.relight(case, schedule, mode).image, case, kappa)
    for name, (mode, pooling, norm) in variants.items():
        kappa, _ = best(results.rows, name)
        schedule = Schedule.uniform(PRESETS[config.schedule], kappa=kappa, pooling=pooling, norm=norm)
        for index in held_out:
            case = cases[index]
            score("held-out", index, name, bench.relight(case, schedule, mode).image, case, kappa)
    for index in held_out:
        case = cases[index]
        relit = bench.relight(case, Schedule.preset(config.schedule))
        for name, image in zip(BASELINES, (relit.unrefined, mean_color(case, relit))):
            score("held-out", index, name, image, case)
    write_blocks(config.out, NAME, blocks(results.finish(), config.out))


def curve(rows: Sequence[Row], method: str) -> dict[float, float]:
    """Mean PSNR on the tuning frames by κ."""
    own = [row for row in of_kind(rows, "score") if (row["split"], row["method"]) == ("tuning", method)]
    kappas = dict.fromkeys(row["kappa"] for row in own)
    return {kappa: float(np.mean([row["psnr"] for row in own if row["kappa"] == kappa])) for kappa in kappas}


def best(rows: Sequence[Row], method: str) -> tuple[float, float]:
    """The κ with the highest mean PSNR on the tuning frames, and this."""
    return max(curve(rows, method).items(), key=lambda point: point[1])


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and figure from the rows."""
    scores = of_kind(rows, "score")
    if not scores:
        return ["No frame has been scored yet."]
    methods = list(dict.fromkeys(row["method"] for row in scores))
    lines = []
    for method in sorted(methods, key=lambda method: method not in BASELINES):
        kappa, decibels = ("", "") if method in BASELINES else best(rows, method)
        held = [row["psnr"] for row in scores if (row["split"], row["method"]) == ("held-out", method)]
        chosen = [str(kappa), f"{decibels:.2f}" if decibels else ""]
        lines.append([method, *chosen, f"{np.mean(held):.2f}" if held else "–"])
    frames = {
        split: len({row["frame"] for row in scores if row["split"] == split}) for split in ("tuning", "held-out")
    }
    caption = (
        f"PSNR of relit frames against the accurate mesh; {scores[0]['settings']['schedule']}, mean over "
        f"{frames['tuning']} tuning frames, on which κ is chosen, and {frames['held-out']} held-out ones."
    )
    header = [f"{scores[0]['capture']}: mode, pooling, norm", "best kappa", "tuning dB", "held-out dB"]
    return [
        Table(caption, header, lines),
        Plot(
            NAME, "PSNR on the tuning frames against κ.", figure(rows, [m for m in methods if m not in BASELINES])
        ),
    ]


def figure(rows: Sequence[Row], methods: Sequence[str]) -> Figure:
    """A curve for each variant."""
    fig = new_figure(6, 4)
    axes = fig.subplots()
    for method in methods:
        points = curve(rows, method)
        axes.semilogx(list(points), list(points.values()), marker="o", label=method)
    axes.set(xlabel="kappa", ylabel="PSNR on tuning frames, dB")
    axes.legend()
    return fig


if __name__ == "__main__":
    run(main, Config)
