"""Shaders of a cascade, generated from its schedule: the mirror of `hyjax.core.cascade`."""

import dataclasses
import itertools
import string
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import ArrayLike

from hyjax.core.pyramid import level_shape
from hyjax.core.schedule import Level, Schedule
from hyjax.device.program import GROUP_SIDE, Groups, Program, columns_rows, grid_of

TILE_CELLS = 32
"""Number of cells along each side of a diffusion tile."""
STEPS_AT_ONCE = 4
"""Number of steps of one launch, each of which costs a rim of one cell on all sides of a tile."""
MOST_STEPS_AT_ONCE = 64
"""Most steps of one launch where a whole level fits into a tile."""

_DISTANCES = {
    "l2": ("dot(d, d)", "total"),
    "mean_abs": ("dot(abs(d), vec4<f32>(1.0))", "total * total / f32({0} * {0})"),
}

_COARSER = string.Template("""
    workgroupBarrier();
    if (all(local.xy % ${step}u == vec2<u32>(0u)) && all(id.xy / ${step}u < vec2<u32>($size))) {
        let cell = id.xy / ${step}u;
        var total = vec4<f32>(0.0);
        var count = 0.0;
        for (var k = 0u; k < ${ratio}u * ${ratio}u; k++) {
            let finer = ${ratio}u * cell + vec2<u32>(k % ${ratio}u, k / ${ratio}u);
            if (any(finer >= vec2<u32>($size_before))) { continue; }
            let n = pixels(finer, ${before}u);
            total += n * means[place + ${step_before}u * ((k / ${ratio}u) * 8u + k % ${ratio}u)];
            count += n;
        }
        means[place] = total / count;
        coarser_$number[(id.z * vec2<u32>($size).y + cell.y) * vec2<u32>($size).x + cell.x] = store(total / count);
    }""")
"""Text of a coarser level in `wgsl/cells.wgsl`."""


@dataclasses.dataclass(frozen=True)
class CoarsePicture:
    """Picture of a level, to be interpolated.

    Attributes:
        factor: pixels along each side of a cell.
        schedule: by which it is interpolated.
        kappa: edge sensitivity of the level.
    """

    buffer: str
    factor: int
    schedule: Schedule
    kappa: float


@dataclasses.dataclass
class CascadeWriter:
    """Writer of cascades to a program, which shares their buffers of the guide.

    Attributes:
        guide: name of the guide's buffer.
        stage: of the launches.
    """

    program: Program
    guide: str
    features: int
    stage: str = "frame"
    _guides: dict[int, str] = dataclasses.field(default_factory=dict)
    _edges: dict[Any, str] = dataclasses.field(default_factory=dict)

    def cascade(self, name: str, source: str, schedule: Schedule, groups: Groups, total: bool = False) -> str:
        """Add a cascade; the buffer of the repaired picture. See `levels`."""
        return self.upsample(name, self.levels(name, source, schedule, groups, total), groups)

    def levels(
        self, name: str, source: str, schedule: Schedule, groups: Groups, total: bool = False
    ) -> "CoarsePicture":
        """Add the levels of a cascade.

        Args:
            total: whether to sum the picture up, into the buffer `<name> totals`.

        Returns:
            What is repaired of the finest level, which is not interpolated yet.
        """
        schedule.check()
        factors = [level.factor for level in schedule.levels]
        means = self._means(name, source, factors, groups)
        if "guide" in (schedule.pooling, schedule.upsampling):
            self._guide_means(factors)
        if total:
            self._total(name, means[factors[0]], factors[0], groups)
        state, coarser, kappa = means[factors[0]], factors[0], _value(schedule.levels[0].kappa)
        for level in schedule.levels:
            if level.factor != coarser:
                coarse = CoarsePicture(state, coarser, schedule, kappa)
                state = self.upsample(name, coarse, groups, level.factor)
            state = self._diffuse(name, state, means[level.factor], level, schedule, groups)
            coarser, kappa = level.factor, _value(level.kappa)
        return CoarsePicture(state, coarser, schedule, kappa)

    def _shape(self, factor: int) -> tuple[int, int]:
        return level_shape(self.program.size, factor)

    def _means(self, name: str, source: str, factors: Sequence[int], groups: Groups) -> dict[int, str]:
        """Buffers of a picture's cell means by factor, each from the next finer one that divides it."""
        return self._cells(name, f"{name} means", {1: source}, sorted(set(factors) - {1}), groups)

    def _guide(self, factor: int) -> str:
        """Buffer of the guide's cell means."""
        return self._guide_means([factor])[factor]

    def _guide_means(self, factors: Sequence[int]) -> dict[int, str]:
        """Buffers of the guide's cell means by factor."""
        known = self._guides | {1: self.guide}
        new = sorted(set(factors) - set(known))
        self._guides = self._cells("guide", "guide", known, new, Groups(-(-self.features // 4)))
        return self._guides

    def _cells(
        self, label: str, name: str, known: Mapping[int, str], factors: Sequence[int], groups: Groups
    ) -> dict[int, str]:
        """Buffers of cell means by factor, with those that are known; rising factors come out of as few launches as
        their cells fit into a workgroup."""
        means = dict(known)
        while factors:
            finer = max(f for f in means if factors[0] % f == 0)
            count = 1
            while count < len(factors) and _is_chain(factors[: count + 1]):
                count += 1
            self._launch_cells(label, name, means, finer, factors[:count], groups)
            factors = factors[count:]
        return means

    def _launch_cells(
        self, label: str, name: str, means: dict[int, str], finer: int, factors: Sequence[int], groups: Groups
    ) -> None:
        shapes = [self._shape(factor) for factor in factors]
        buffers = [
            self.program.picture(f"{name} {factor}", shape, groups)
            for factor, shape in zip(factors, shapes, strict=True)
        ]
        more = range(1, len(factors))
        self.program.launch(
            self.stage,
            label,
            ["cells"],
            [means[finer], *buffers],
            grid_of(shapes[0]),
            groups,
            constants={
                "full": columns_rows(self.program.size),
                "fine": columns_rows(self._shape(finer)),
                "coarse": columns_rows(shapes[0]),
                "fine_factor": finer,
                "ratio": factors[0] // finer,
                "coarser_bindings": "\n".join(
                    f"@group(0) @binding({k + 1}) var<storage, read_write> coarser_{k}: array<Stored>;"
                    for k in more
                ),
                "coarser": "\n".join(
                    _COARSER.substitute(
                        number=k,
                        before=factors[k - 1],
                        size=columns_rows(shapes[k]),
                        size_before=columns_rows(shapes[k - 1]),
                        ratio=factors[k] // factors[k - 1],
                        step=factors[k] // factors[0],
                        step_before=factors[k - 1] // factors[0],
                    )
                    for k in more
                ),
            },
        )
        means.update(zip(factors, buffers))

    def _distance(self, schedule: Schedule) -> str:
        """Shader functions of the distance of two guides."""
        part, total = _DISTANCES[schedule.norm]
        return (
            f"fn difference(d: vec4<f32>) -> f32 {{ return {part}; }}\n"
            f"fn distance_of(total: f32) -> f32 {{ return {total.format(self.features)}; }}"
        )

    def _level_edges(self, level: Level, schedule: Schedule) -> str:
        """Buffer of a level's conductances."""
        pooled = schedule.pooling == "edges" and level.factor > 1
        kappa = _value(level.kappa)
        key = level.factor, kappa, pooled, schedule.norm
        if key not in self._edges:
            shape = self._shape(level.factor)
            name = f"edges {level.factor} {len(self._edges)}"
            self._edges[key] = self.program.buffer(name, 8 * shape[0] * shape[1])
            down, right = "between(id.xy, id.xy + vec2<u32>(0u, 1u))", "between(id.xy, id.xy + vec2<u32>(1u, 0u))"
            if pooled:
                down, right = "largest(id.xy, true)", "largest(id.xy, false)"
            self.program.launch(
                self.stage,
                "conductances",
                ["edges"],
                [self.guide if pooled else self._guide(level.factor), name],
                grid_of(shape),
                constants={
                    "guide": columns_rows(self.program.size if pooled else shape),
                    "cells": columns_rows(shape),
                    "groups": -(-self.features // 4),
                    "factor": level.factor,
                    "scale": _scale(kappa),
                    "distance": self._distance(schedule),
                    "pooling": schedule.pooling,
                    "down": down,
                    "right": right,
                },
            )
        return self._edges[key]

    def _diffuse(self, name: str, state: str, means: str, level: Level, schedule: Schedule, groups: Groups) -> str:
        """Buffer of a level after its steps."""
        shape, sizes = self._shape(level.factor), [float(lam) for lam in np.asarray(level.step_sizes)]
        edges = self._level_edges(level, schedule) if sizes else ""
        update, source, binding = "own + lam * flow", "y[q]", ""
        if level.fidelity is not None:
            alpha = _number(_value(level.fidelity))
            update = f"(own + lam * flow + lam * {alpha} * source[q]) / (1.0 + lam * {alpha})"
            source = "load(means[index])"
            binding = "@group(0) @binding(3) var<storage, read> means: array<Stored>;"
        fits = max(shape) <= TILE_CELLS
        most = MOST_STEPS_AT_ONCE if fits else STEPS_AT_ONCE
        for run in np.array_split(sizes, -(-len(sizes) // most)) if sizes else []:
            names = [f"{name} state {level.factor} {side}" for side in "ab"]
            after = self.program.picture(names[state == names[0]], shape, groups)
            rim = 0 if fits else len(run)
            self.program.launch(
                self.stage,
                name,
                ["diffuse"],
                [state, edges, after, *([means] if binding else [])],
                grid_of(shape, TILE_CELLS - 2 * rim),
                groups,
                constants={
                    "size": columns_rows(shape),
                    "rim": rim,
                    "steps": len(run),
                    "step_sizes": ", ".join(_number(float(lam)) for lam in run),
                    "update": update,
                    "source": source,
                    "source_binding": binding,
                },
            )
            state = after
        return state

    def upsample(self, name: str, coarse: "CoarsePicture", groups: Groups, factor: int = 1, stage: str = "") -> str:
        """Buffer of a picture at a finer level."""
        if coarse.factor == factor:
            return coarse.buffer
        fine = self.program.picture(f"{name} state {factor} a", self._shape(factor), groups)
        guides, constants = self.interpolation(coarse, 2, factor)
        self.program.launch(
            stage or self.stage,
            name,
            ["interpolate", "upsample"],
            [coarse.buffer, fine, *guides],
            grid_of(self._shape(factor)),
            groups,
            constants=constants,
        )
        return fine

    def interpolation(
        self, coarse: "CoarsePicture", binding: int, factor: int = 1
    ) -> tuple[list[str], dict[str, object]]:
        """Buffers that `wgsl/interpolate.wgsl` needs from a binding on, and its constants."""
        shape, guides, bindings = self._shape(factor), [], ""
        likeness = "fn likeness(pixel: vec2<u32>, cell: vec2<u32>) -> f32 { return 1.0; }"
        if coarse.schedule.upsampling == "guide" and coarse.factor > factor:
            guides = [self._guide(factor), self._guide(coarse.factor)]
            bindings = (
                f"@group(0) @binding({binding}) var<storage, read> fine_guide: array<Stored>;\n"
                f"@group(0) @binding({binding + 1}) var<storage, read> coarse_guide: array<Stored>;"
            )
            likeness = f"""{self._distance(coarse.schedule)}
fn likeness(pixel: vec2<u32>, cell: vec2<u32>) -> f32 {{
    var total = 0.0;
    for (var group = 0u; group < {-(-self.features // 4)}u; group++) {{
        let own = load(fine_guide[(group * FINE.y + pixel.y) * FINE.x + pixel.x]);
        let other = load(coarse_guide[(group * u32(COARSE.y) + cell.y) * u32(COARSE.x) + cell.x]);
        total += difference(own - other);
    }}
    return 1.0 / (1.0 + distance_of(total) * f32({_scale(coarse.kappa)}));
}}"""
        return guides, {
            "fine": columns_rows(shape),
            "coarse": columns_rows(self._shape(coarse.factor)),
            "factor": coarse.factor // factor,
            "guide_bindings": bindings,
            "likeness": likeness,
        }

    def _total(self, name: str, means: str, factor: int, groups: Groups) -> None:
        """Sum of the picture, from the means of its coarsest cells."""
        self.program.launch(
            self.stage,
            name,
            ["total"],
            [means, self.program.buffer(f"{name} totals", 16, groups)],
            (1, 1),
            groups,
            constants={
                "full": columns_rows(self.program.size),
                "cells": columns_rows(self._shape(factor)),
                "factor": factor,
            },
        )


def _is_chain(factors: Sequence[int]) -> bool:
    """Whether each level has whole cells of the one before in its own, and those of the last fit a workgroup."""
    whole = all(coarse % fine == 0 for fine, coarse in itertools.pairwise(factors))
    return whole and GROUP_SIDE % (factors[-1] // factors[0]) == 0


def _value(leaf: ArrayLike) -> float:
    """Number of a schedule."""
    return float(np.asarray(leaf))


def _number(value: float) -> str:
    """WGSL literal of a float32."""
    return str(np.format_float_scientific(np.float32(value), unique=True))


def _scale(kappa: float) -> str:
    """Scale 1 / κ² of squares, within float32's range."""
    return _number(float(np.clip(kappa, 1e-15, 1e15)) ** -2)
