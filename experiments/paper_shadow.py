"""The paper's second ablation: shadows diffused together with the filter, against a pass of their own.

Of each light, what it leaves visible is estimated three ways: looked up in a surface's shadow map (*raw*); as the
ratio of the filter diffused with its shadows in it to the filter diffused without (*together*); and refined by a
pass of its own with few steps at high resolution (*separate*), of which a sweep tells what they do. All are
compared with the shadow that the accurate surface throws on itself, where that is relied on and the light is not
dim, by

- *overlap*: intersection over union of the shadows (visibility below one half);
- *edge error*: mean difference of visibility within `EDGE` of the true shadow's border;
- *border offset*: mean distance in pixels between the two borders, both ways, none counted for more than
  `FARTHEST_PIXELS`.

Once on the rough surface, as in use; and once on the accurate surface, where raw is the truth itself, so that what
is lost is the diffusion's doing alone. A sweep tells what the steps of the separate pass do, at full and at half
size.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy import ndimage

import hyjax
from experiments.blocks import Block, Picture, Plot, Table
from experiments.judging import middle
from experiments.paper_bench import METHODS, Bench
from experiments.paper_view import View
from experiments.plotting import new_figure
from experiments.records import Row, of_kind, size_of
from hyjax.core.schedule import Schedule
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.light.color import encoded
from hyjax.pipeline import Mode

LIGHTS = "two-colors"
STEPS = (0, 1, 2, 4, 8, 16, 32, 64, 128)
SURFACES = ("rough", "accurate")
SIZES = {1: "full", 2: "half"}
"""Sizes by factor."""
EDGE = 8 / 512  # of the picture's height
FARTHEST_PIXELS = 32  # pixels
DIM_SHARE = 0.05  # of the reference illuminance: less light than this shows no shadow
METRICS = {"overlap": 3, "edge_error": 3, "border_offset": 2}
"""Metric → its decimals."""
METRIC_NAMES = {"overlap": "overlap", "edge_error": "edge error", "border_offset": "border offset in pixels"}
SHEET = (
    "frame",
    "rough: raw",
    "rough: together",
    "rough: separate",
    "accurate: together",
    "accurate: separate",
    "accurate: raw",
)
GAIN = 3.0  # of the sheet's pictures, in linear light


def shadow_maps(bench: Bench) -> dict[str, Any]:
    """Shadow maps of both surfaces."""
    casters = bench.rough, RayCaster(bench.reference.geometry)
    lights = bench.setups[LIGHTS].lights
    return {surface: cast_shadow_maps(caster, lights) for surface, caster in zip(SURFACES, casters)}


def judge(
    maps: Mapping[str, Any], bench: Bench, view: View
) -> tuple[list[dict[str, Any]], list[tuple[str, list[Any]]]]:
    """Scores of a frame's shadows, and its rows of the contact sheet."""
    scores, sheet = [], []
    for mode in METHODS:
        truth = Lit(view, bench, mode, maps["accurate"], accurate=True)
        enough = np.asarray(truth.each) > DIM_SHARE * bench.setups[LIGHTS].reference_lux
        counted = view.valid[..., None] & enough
        for surface, lit in {"rough": Lit(view, bench, mode, maps["rough"]), "accurate": truth}.items():
            for (method, factor, steps), visible in estimate(lit, view, bench, mode).items():
                for light in range(counted.shape[-1]):
                    true = np.asarray(truth.visible)[..., light]
                    found = compare(visible[..., light], true, counted[..., light])
                    if found is not None:
                        key = {"method": method, "factor": factor, "steps": steps, "light": light}
                        scores.append({"mode": mode, "surface": surface, **key, **found})
        shown = pictures(view, bench, mode, maps["rough"], maps["accurate"])
        sheet.append((f"{view.frame.name}, {mode} mode", shown))
    return scores, sheet


class Lit:
    """A surface under each light by itself, a channel for each.

    Attributes:
        each: lux without shadows.
        unshadowed: the filter that is diffused: lux, or display values in the paper's mode.
        shadowed: the same with shadows.
        visible: their ratio.
        hit: where there is a surface.
    """

    def __init__(self, view: View, bench: Bench, mode: Mode, maps: Any, *, accurate: bool = False) -> None:
        setup, gbuffer = bench.setups[LIGHTS], view.accurate if accurate else view.rough
        self.hit = gbuffer.hit[..., None]
        self.each = hyjax.shade_each(gbuffer, setup.lights)
        shadowed = self.each * hyjax.visibilities(gbuffer, setup.lights, maps)
        filters = self.each, shadowed
        if mode == "paper":
            filters = tuple(encoded(x / setup.reference_lux) for x in filters)  # type: ignore[assignment]
        self.unshadowed, self.shadowed = filters
        self.visible = ratio(self.shadowed, self.unshadowed)


def ratio(part: Array, whole: Array) -> Array:
    """Part of the whole that is left; 1 where there is nothing to lose."""
    return jnp.where(whole > 1e-6, jnp.clip(part / jnp.maximum(whole, 1e-6), 0.0, 1.0), 1.0)


def estimate(rough: Lit, view: View, bench: Bench, mode: Mode) -> Mapping[tuple[str, int, int], np.ndarray]:
    """(method, factor, steps) → visibility of each light."""
    guide, schedule = view.guide, bench.own_kappa(bench.schedules[mode], mode)
    made = {("raw", 1, 0): rough.visible}
    if mode == "paper":
        together = ratio(*(hyjax.cascade(y, guide, schedule) for y in (rough.shadowed, rough.unshadowed)))
        start = rough.visible
    else:
        known = (hyjax.cascade_known(y, rough.hit, guide, schedule) for y in (rough.shadowed, rough.unshadowed))
        together = ratio(*known)
        start = hyjax.fill_visibility(rough.visible, rough.each > 0, guide)
    made["together", 1, 0] = together
    for factor in SIZES:
        for steps in STEPS:
            own = bench.own_kappa(Schedule.uniform([(factor, steps)]), mode)
            made["separate", factor, steps] = hyjax.shadow_pass(start, guide, own)
    return {key: np.asarray(value) for key, value in made.items()}


def compare(
    visible: Float[np.ndarray, "h w"], truth: Float[np.ndarray, "h w"], counted: Bool[np.ndarray, "h w"]
) -> dict[str, float] | None:
    """Overlap, edge error and border offset of one shadow; None if there is none to speak of."""
    dark, true = (visible < 0.5) & counted, (truth < 0.5) & counted
    if true.sum() < 1e-3 * truth.size or not (counted & ~true).any():
        return None
    border, true_border = (_border(x, counted) for x in (dark, true))
    from_true = ndimage.distance_transform_edt(~true_border) if true_border.any() else np.full(true.shape, np.inf)
    near = counted & (from_true < max(1.0, EDGE * truth.shape[0]))
    if not near.any():
        return None
    offsets = [np.minimum(from_true[border], FARTHEST_PIXELS)]
    from_own = ndimage.distance_transform_edt(~border) if border.any() else np.full(true.shape, np.inf)
    offsets.append(np.minimum(from_own[true_border], FARTHEST_PIXELS))
    return {
        "overlap": float((dark & true).sum() / (dark | true).sum()),
        "edge_error": float(np.abs(visible - truth)[near].mean()),
        "border_offset": float(np.mean([x.mean() for x in offsets if x.size])),
    }


def _border(shadow: Bool[np.ndarray, "h w"], counted: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Pixels of a shadow beside light that counts."""
    return shadow & ndimage.binary_dilation(counted & ~shadow)


def pictures(view: View, bench: Bench, mode: Mode, rough_maps: Any, accurate_maps: Any) -> list[np.ndarray]:
    """A row of the sheet: the frame relit with each estimate of the shadows, brighter than it would be."""
    relit = []
    for maps, accurate in ((rough_maps, False), (accurate_maps, True)):
        separate = bench.relight(view, LIGHTS, mode, bench.schedules[mode], accurate=accurate, shadow_maps=maps)
        relit += [separate.unrefined, together(view, bench, mode, maps, accurate), separate.image]
    truth = relit.pop(3)
    seen = [np.asarray(hyjax.to_display(GAIN * x)) for x in (*relit, truth)]
    return [np.asarray(view.display), *seen]


def together(view: View, bench: Bench, mode: Mode, maps: Any, accurate: bool) -> Array:
    """The frame relit with a filter that was diffused with its shadows in it; linear."""
    setup, linear = bench.setups[LIGHTS], hyjax.to_linear(view.display)
    schedule = bench.own_kappa(bench.schedules[mode], mode)
    lit = Lit(view, bench, "linear", maps, accurate=accurate)
    if mode == "paper":
        raw = encoded(hyjax.colored(lit.shadowed, setup.lights) / setup.reference_lux)
        return hyjax.to_linear(hyjax.cascade(raw, view.guide, schedule) * view.display)
    each = hyjax.cascade_known(lit.shadowed, lit.hit, view.guide, schedule)
    return hyjax.colored(each, setup.lights) / setup.reference_lux * linear


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Tables, figure and picture from the rows."""
    scores = [score | {"frame": row["frame"]} for row in of_kind(rows, "shadow") for score in row["scores"]]
    paper, ours = (hyjax.Schedule.preset(name).levels[0] for name in ("shadow", "hyjax-shadow"))
    kinds = {
        "raw": ("raw", 1, 0),
        "together": ("together", 1, 0),
        f"separate, {paper.steps} steps": ("separate", paper.factor, paper.steps),
        f"separate, {ours.steps} steps": ("separate", ours.factor, ours.steps),
    }
    header = ["", "overlap", "edge error", "border offset px"]
    made: list[Block] = []
    for surface in SURFACES:
        own = [score for score in scores if score["surface"] == surface]
        shadows, frames = ({tuple(s[k] for k in keys) for s in own} for keys in (("frame", "light"), ("frame",)))
        lines = [
            [f"{mode} mode, {name}", *cells(own, mode, *key)] for mode in METHODS for name, key in kinds.items()
        ]
        caption = (
            f"On the {surface} surface at {size_of(rows)}: {len(shadows)} shadows of one light in one frame; "
            f"median over {len(frames)} frames (95 % interval) of each frame's mean."
        )
        made.append(Table(caption, header, lines))
    caption = "Steps of the separate pass, means over shadows."
    return [
        *made,
        Plot("shadow_steps", caption, figure(scores)),
        Picture(folder / "shadow.png", f"Frames relit with shadows, {GAIN:g} times as bright."),
    ]


def cells(scores: Sequence[Row], mode: str, method: str, factor: int, steps: int) -> list[str]:
    """Medians over frames with their intervals."""
    own = chosen(scores, mode, method, factor, steps)
    frames = [[row for row in own if row["frame"] == name] for name in dict.fromkeys(row["frame"] for row in own)]
    each = {metric: [float(np.mean([row[metric] for row in rows])) for rows in frames] for metric in METRICS}
    found = [(middle(each[metric]), digits) for metric, digits in METRICS.items()]
    return ["–" if summary is None else summary.text(digits) for summary, digits in found]


def chosen(scores: Sequence[Row], mode: str, method: str, factor: int, steps: int) -> list[Row]:
    wanted = (mode, method, factor, steps)
    return [row for row in scores if (row["mode"], row["method"], row["factor"], row["steps"]) == wanted]


def figure(scores: Sequence[Row]) -> Any:
    """Each metric against the steps of the separate pass: a row of panels for each surface."""
    fig = new_figure(12, 7.5)
    axes = fig.subplots(len(SURFACES), len(METRICS), sharex=True, sharey="col")
    for line, surface in zip(axes, SURFACES):
        own = [row for row in scores if row["surface"] == surface]
        for ax, metric in zip(line, METRICS):
            for k, mode in enumerate(METHODS):
                for factor, size in SIZES.items():
                    rows = [chosen(own, mode, "separate", factor, steps) for steps in STEPS]
                    mean = [np.mean([row[metric] for row in r]) if r else np.nan for r in rows]
                    face = f"C{k}" if factor == 1 else "none"
                    label = f"{mode} mode, separate, {size} size"
                    ax.plot(range(len(STEPS)), mean, "-o", color=f"C{k}", label=label, markerfacecolor=face)
                for method, style in (("together", "--"), ("raw", ":")):
                    values = [row[metric] for row in chosen(own, mode, method, 1, 0)]
                    label = f"{mode} mode, {method}"
                    level = np.mean(values) if values else np.nan
                    ax.axhline(level, color=f"C{k}", linestyle=style, linewidth=1, label=label)
            ax.set_xticks(range(len(STEPS)), [str(n) for n in STEPS])
            ax.set_title(f"{METRIC_NAMES[metric]}, {surface} surface")
    for ax in axes[-1]:
        ax.set(xlabel="steps of the separate pass", ylim=(0, None))
    fig.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    return fig
