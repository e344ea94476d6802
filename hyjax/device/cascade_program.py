"""Shaders of a cascade, generated from its schedule: the mirror of `hyjax.core.cascade`."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import ArrayLike

from hyjax.core.pyramid import level_shape
from hyjax.core.schedule import Level, Schedule
from hyjax.device.program import Groups, Program, columns_rows, grid_of

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


@dataclasses.dataclass
class CascadeWriter:
    """Writer of cascades to a program, which shares their buffers of the guide.

    Attributes:
        program: to write to.
        guide: name of the guide's buffer.
        features: channels of the guide.
        stage: of the launches.
    """

    program: Program
    guide: str
    features: int
    stage: str = "frame"
    _guides: dict[int, str] = dataclasses.field(default_factory=dict)
    _edges: dict[Any, str] = dataclasses.field(default_factory=dict)

    def cascade(self, name: str, source: str, schedule: Schedule, groups: Groups, total: bool = False) -> str:
        """Add a cascade.

        Args:
            name: of its buffers, and in timings.
            source: buffer of the picture.
            schedule: levels with their steps.
            groups: channel groups of the picture.
            total: whether to sum the picture up, into the buffer `<name> totals`.

        Returns:
            The buffer of the repaired picture.
        """
        schedule.check()
        factors = [level.factor for level in schedule.levels]
        means = self._means(name, source, factors, groups)
        if "guide" in (schedule.pooling, schedule.upsampling):
            for factor in sorted(factors):  # coarse cells from fine ones
                self._guide(factor)
        if total:
            self._total(name, means[factors[0]], factors[0], groups)
        state, coarser, kappa = means[factors[0]], factors[0], _value(schedule.levels[0].kappa)
        for level in schedule.levels:
            if level.factor != coarser:
                state = self._upsample(name, state, coarser, level.factor, schedule, kappa, groups)
            state = self._diffuse(name, state, means[level.factor], level, schedule, groups)
            coarser, kappa = level.factor, _value(level.kappa)
        return self._upsample(name, state, coarser, 1, schedule, kappa, groups) if coarser > 1 else state

    def _shape(self, factor: int) -> tuple[int, int]:
        return level_shape(self.program.size, factor)

    def _means(self, name: str, source: str, factors: Sequence[int], groups: Groups) -> dict[int, str]:
        """Buffers of a picture's cell means by factor, each from the next finer one that divides it."""
        means = {1: source}
        for factor in sorted(set(factors) - {1}):
            means[factor] = self._cells(name, f"{name} means {factor}", means, factor, groups)
        return means

    def _guide(self, factor: int) -> str:
        """Buffer of the guide's cell means."""
        known = self._guides | {1: self.guide}
        if factor not in known:
            groups = Groups(-(-self.features // 4))
            known[factor] = self._guides[factor] = self._cells("guide", f"guide {factor}", known, factor, groups)
        return known[factor]

    def _cells(self, label: str, name: str, finer_means: Mapping[int, str], factor: int, groups: Groups) -> str:
        """Buffer of cell means, from the coarsest of finer ones that divides them."""
        finer, shape = max(f for f in finer_means if factor % f == 0), self._shape(factor)
        cells = self.program.picture(name, shape, groups)
        self.program.launch(
            self.stage,
            label,
            ["cells"],
            [finer_means[finer], cells],
            grid_of(shape),
            groups,
            constants={
                "full": columns_rows(self.program.size),
                "fine": columns_rows(self._shape(finer)),
                "coarse": columns_rows(shape),
                "fine_factor": finer,
                "ratio": factor // finer,
            },
        )
        return cells

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

    def _upsample(
        self, name: str, state: str, coarser: int, factor: int, schedule: Schedule, kappa: float, groups: Groups
    ) -> str:
        """Buffer of a finer level before its steps."""
        shape = self._shape(factor)
        fine = self.program.picture(f"{name} state {factor} a", shape, groups)
        bind, bindings = [state, fine], ""
        likeness = "fn likeness(pixel: vec2<u32>, cell: vec2<u32>) -> f32 { return 1.0; }"
        if schedule.upsampling == "guide":
            bind += [self._guide(factor), self._guide(coarser)]
            bindings = (
                "@group(0) @binding(2) var<storage, read> fine_guide: array<Stored>;\n"
                "@group(0) @binding(3) var<storage, read> coarse_guide: array<Stored>;"
            )
            likeness = f"""{self._distance(schedule)}
fn likeness(pixel: vec2<u32>, cell: vec2<u32>) -> f32 {{
    var total = 0.0;
    for (var group = 0u; group < {-(-self.features // 4)}u; group++) {{
        let own = load(fine_guide[(group * FINE.y + pixel.y) * FINE.x + pixel.x]);
        let other = load(coarse_guide[(group * u32(COARSE.y) + cell.y) * u32(COARSE.x) + cell.x]);
        total += difference(own - other);
    }}
    return 1.0 / (1.0 + distance_of(total) * f32({_scale(kappa)}));
}}"""
        self.program.launch(
            self.stage,
            name,
            ["upsample"],
            bind,
            grid_of(shape),
            groups,
            constants={
                "fine": columns_rows(shape),
                "coarse": columns_rows(self._shape(coarser)),
                "factor": coarser // factor,
                "guide_bindings": bindings,
                "likeness": likeness,
            },
        )
        return fine

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


def _value(leaf: ArrayLike) -> float:
    """Number of a schedule."""
    return float(np.asarray(leaf))


def _number(value: float) -> str:
    """WGSL literal of a float32."""
    return str(np.format_float_scientific(np.float32(value), unique=True))


def _scale(kappa: float) -> str:
    """Scale 1 / κ² of squares, within float32's range."""
    return _number(float(np.clip(kappa, 1e-15, 1e15)) ** -2)
