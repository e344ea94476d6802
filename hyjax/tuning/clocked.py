"""What the budget is for: the diffusion alone, or the whole frame. Predicts and times schedules."""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, Protocol

import jax
import jax.numpy as jnp

from hyjax.color import to_linear
from hyjax.compositing import composite
from hyjax.errors import InputError
from hyjax.pipeline import relight
from hyjax.refine import fill_visibility, shadow_pass
from hyjax.scene.shadow_caster import cast_shadow_maps
from hyjax.schedule import Schedule, guided_schedule
from hyjax.shading import shade_each
from hyjax.shadow import ShadowMap, visibilities
from hyjax.tuning import calibration
from hyjax.tuning.bench import Workbench
from hyjax.tuning.cases import Case
from hyjax.tuning.latency_table import (
    CostModel,
    LatencyTable,
    Workload,
    load_table,
    save_table,
    schedule_key,
    time_schedules,
    time_stages,
)
from hyjax.tuning.result import Milliseconds

Stage = Literal["cascade", "frame"]
REPEATS = 100
STAGE_REPEATS = 20


class Clocked(Protocol):
    """Something whose time depends on a schedule."""

    table: LatencyTable
    """Where its times are kept."""

    cost: CostModel
    """Of the 95th percentile, over the ladder: what the search keeps below the budget."""

    def predict(self, schedule: Schedule) -> Milliseconds:
        """By the latency table."""
        ...

    def measure(
        self, schedules: Sequence[Schedule], *, again: bool = False, progress: bool = True
    ) -> list[Milliseconds]:
        """On the clock, in turns; what was timed on this table before is timed again only if asked for."""
        ...

    def parts(self) -> dict[str, float]:
        """Milliseconds (95th percentile) of what no schedule can change, dearest first."""
        ...


def workload_of(case: Case) -> Workload:
    """The shapes of a case."""
    h, w, lights = case.shading.shape
    return Workload(h, w, lights, case.guide.shape[-1], str(case.shading.dtype))


def searchable(schedule: Schedule) -> bool:
    """Whether a schedule has the form that the search gives all of its own."""
    attached = all(level.attachment is not None for level in schedule.levels)
    return schedule.upsampling == schedule.pooling == "guide" and schedule.norm == "l2" and attached


class CascadeClock:
    """The diffusion stage: `cascade_known`, from the shading to the refined filter.

    Args:
        case: the arrays to time on.
        recalibrate: whether to make the latency table anew.
        progress: show bars on stderr.
    """

    def __init__(self, case: Case, *, recalibrate: bool = False, progress: bool = True) -> None:
        self.table, self.source = load_table(workload_of(case), recalibrate=recalibrate, progress=progress)
        self.arguments = case.shading, case.known, case.guide
        self.cost = self.table.p95

    def predict(self, schedule: Schedule) -> Milliseconds:
        known = self.table.timed.get(schedule_key(schedule))
        if known is not None and not searchable(schedule):
            return known  # the table's model is of the form that is searched
        return self.table.predict(self.table.steps_of(schedule))

    def measure(
        self, schedules: Sequence[Schedule], *, again: bool = False, progress: bool = True
    ) -> list[Milliseconds]:
        times = time_schedules(
            self.table, schedules, arguments=self.arguments, repeats=REPEATS, again=again, progress=progress
        )
        save_table(self.table)
        return times

    def parts(self) -> dict[str, float]:
        cheapest = min(level + finest for level, finest in zip(self.table.p95.level, self.table.p95.finest))
        return {"reading, weighting and upsampling the filter": self.table.p95.fixed, "one level": cheapest}


class FrameClock:
    """A whole frame: G-buffer, guide, shading, visibility, diffusion, shadow pass and composite, without files.

    Args:
        cascade: for the table.
        bench: what renders the frame.
        index: of the frame to time on, which must see the mesh.
    """

    NAMES = ("G-buffer", "guide", "shading", "visibility", "shadow pass", "composite")

    def __init__(self, cascade: CascadeClock, bench: Workbench, index: int) -> None:
        self.cascade, self.table = cascade, cascade.table
        frame, self.caster = bench.frame(index), bench.rough
        self.camera, self.lights = frame.camera, tuple(bench.setup.lights)
        self.display, self.reference_lux = jnp.asarray(frame.image), bench.setup.reference_lux
        self.guide = bench.guide
        kinds = ", ".join(type(light).__name__ for light in self.lights)
        with_what = f"{kinds}; {len(self.caster.mesh.faces)} triangles; {self.guide.name} guide"
        self.stages = {name: f"{name} ({with_what})" for name in self.NAMES}
        if any(stage not in self.table.stages for stage in self.stages.values()):
            calls = self._calls()
            time_stages(self.table, {self.stages[n]: calls[n] for n in self.NAMES}, STAGE_REPEATS)
            save_table(self.table)
        stages = [self._stage(name) for name in self.NAMES]
        self.rest = Milliseconds(sum(stage.median for stage in stages), sum(stage.p95 for stage in stages))
        self.cost = dataclasses.replace(self.table.p95, fixed=self.rest.p95 + self.table.p95.fixed)

    @functools.cached_property
    def maps(self) -> list[ShadowMap | None]:
        """Made when first needed: stages that the table knows need none."""
        return list(cast_shadow_maps(self.caster, self.lights))

    def _stage(self, name: str) -> Milliseconds:
        return self.table.stages[self.stages[name]]

    def _calls(self) -> Mapping[str, Callable[[], Any]]:
        """Each stage by itself."""
        gbuffer = self.caster.gbuffer(self.camera)
        each, shadow = shade_each(gbuffer, self.lights), Schedule.preset("hyjax-shadow")
        seen, linear = visibilities(gbuffer, self.lights, self.maps), to_linear(self.display)
        features = self.guide.features(self.display)
        return {
            "G-buffer": lambda: self.caster.gbuffer(self.camera),
            "guide": lambda: self.guide.features(self.display),
            "shading": lambda: shade_each(gbuffer, self.lights),
            "visibility": lambda: visibilities(gbuffer, self.lights, self.maps),
            "shadow pass": lambda: shadow_pass(fill_visibility(seen, each > 0, features), features, shadow),
            "composite": lambda: composite(linear, linear),
        }

    def predict(self, schedule: Schedule) -> Milliseconds:
        known = self.table.timed.get(self._key(schedule))
        if known is not None and not searchable(schedule):
            return known
        own = self.cascade.predict(schedule)
        return Milliseconds(self.rest.median + own.median, self.rest.p95 + own.p95)

    def measure(
        self, schedules: Sequence[Schedule], *, again: bool = False, progress: bool = True
    ) -> list[Milliseconds]:
        keys = [self._key(schedule) for schedule in schedules]
        wanted = {key: schedule for key, schedule in zip(keys, schedules) if again or key not in self.table.timed}
        if wanted:
            calls = {key: (lambda s=schedule: self._frame(s)) for key, schedule in wanted.items()}
            most = 2 * calibration.MOST_SECONDS
            self.table.timed.update(calibration.time_calls(calls, REPEATS, most_seconds=most, progress=progress))
            save_table(self.table)
        return [self.table.timed[key] for key in keys]

    def _key(self, schedule: Schedule) -> str:
        return f"whole frame {schedule_key(schedule)} {self.stages['G-buffer']}"

    def _frame(self, schedule: Schedule) -> jax.Array:
        gbuffer = self.caster.gbuffer(self.camera)
        return relight(
            to_linear(self.display),
            gbuffer,
            self.lights,
            self.guide.features(self.display),
            schedule,
            shadow_maps=self.maps,
            reference_lux=self.reference_lux,
        ).image

    def parts(self) -> dict[str, float]:
        own = self.cascade.parts()
        times = {name: self._stage(name).p95 for name in self.NAMES}
        times["diffusion"] = sum(own.values())
        return dict(sorted(times.items(), key=lambda item: -item[1]))


def smallest_schedules(clock: Clocked) -> list[Schedule]:
    """One step at each level of the clock's ladder alone, the fastest first, by the latency table."""
    singles = [guided_schedule([(factor, 1)], name=f"1 step at 1/{factor}") for factor in clock.table.ladder]
    return sorted(singles, key=lambda schedule: clock.predict(schedule).p95)


def check_reachable(clock: Clocked, milliseconds: float) -> None:
    """Raise `InputError` if even the smallest schedule, on the clock, takes longer than the budget."""
    cheapest = smallest_schedules(clock)[:2]
    fastest = min(time.p95 for time in clock.measure(cheapest, progress=False))
    if fastest > milliseconds:  # not to refuse for a bad moment that the table remembers
        fastest = min(time.p95 for time in clock.measure(cheapest, again=True, progress=False))
    if fastest > milliseconds:
        parts = ", ".join(f"{name} {time:.2f} ms" for name, time in clock.parts().items())
        raise InputError(
            f"budget {milliseconds:.3g} ms: out of reach on this device; the smallest reachable time (p95) is "
            f"{fastest:.2f} ms ({parts}); give at least --budget-ms {fastest * 1.05:.3g}, or a smaller --size"
        )
