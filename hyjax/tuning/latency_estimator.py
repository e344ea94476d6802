"""Latency estimators: predicted and measured times of a schedule's diffusion alone, or of the whole frame."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import jax
import jax.numpy as jnp

from hyjax.core.schedule import Schedule, guided_schedule
from hyjax.light.relit import composite_linear
from hyjax.light.shading import shade_each
from hyjax.light.shadow_map import visibilities
from hyjax.light.view import View
from hyjax.pipeline import refine_visibility, relight
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
from hyjax.util.errors import InputError

REPEATS = 100
STAGE_REPEATS = 20


class LatencyEstimator(Protocol):
    """Times of whatever a budget is for, by schedule."""

    table: LatencyTable
    """Where its times are kept."""

    cost: CostModel
    """Of the 95th percentile, over the table's factors: what the search keeps below the budget."""

    source: str
    """In a few words, where the times are from."""

    device: str
    """Name of the device, where it is not the one that searches; else empty."""

    def predict(self, schedule: Schedule) -> Milliseconds:
        """By the latency table."""
        ...

    def is_timed(self, schedule: Schedule) -> bool:
        """Whether what `measure` has said of a schedule was timed; predicted if not."""
        ...

    def measure(
        self, schedules: Sequence[Schedule], *, again: bool = False, progress: bool = True
    ) -> list[Milliseconds]:
        """On the clock, in turns, where the device is within reach, else as `predict`.

        What was timed on this table before is timed again only if asked for.
        """
        ...

    def parts(self) -> dict[str, float]:
        """Milliseconds (95th percentile) of what no schedule can change, dearest first."""
        ...


def workload_of(case: Case) -> Workload:
    """The shapes of a case."""
    h, w, lights = case.shaded.illuminance.shape
    return Workload(h, w, lights, case.guide.shape[-1], str(case.shaded.illuminance.dtype))


def has_searched_form(schedule: Schedule) -> bool:
    """Whether a schedule has the form that the search gives all of its own."""
    with_data_term = all(level.fidelity is not None for level in schedule.levels)
    return schedule.upsampling == schedule.pooling == "guide" and schedule.norm == "l2" and with_data_term


class LatencySource(Protocol):
    """What makes the estimator of a run, in the place of this machine's."""

    @property
    def fingerprint(self) -> str:
        """Of the times."""
        ...

    def __call__(self, case: Case) -> LatencyEstimator:
        """Estimator for frames like this one."""
        ...


class OwnEstimator:
    """Base of this machine's estimators."""

    device = ""

    def is_timed(self, schedule: Schedule) -> bool:
        """Always: this machine is there."""
        return True


class CascadeEstimator(OwnEstimator):
    """Times of the diffusion stage, `cascade_known`.

    Args:
        case: the arrays to time on.
        recalibrate: whether to make the latency table anew.
        progress: show bars on stderr.
    """

    def __init__(self, case: Case, *, recalibrate: bool = False, progress: bool = True) -> None:
        self.table, self.source = load_table(workload_of(case), recalibrate=recalibrate, progress=progress)
        self.arguments = case.cascade_arguments
        self.cost = self.table.p95

    def predict(self, schedule: Schedule) -> Milliseconds:
        known = self.table.timed.get(schedule_key(schedule))
        if known is not None and not has_searched_form(schedule):
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


class FrameEstimator(OwnEstimator):
    """Times of a whole frame: view, guide, shading, visibility, diffusion, shadow pass, composite; without files.

    Args:
        cascade: for the table.
        bench: scene, lights and guide.
        index: of the frame to time on, which must see the mesh.
    """

    STAGES = ("G-buffer", "guide", "shading", "visibility", "shadow pass", "linear composite")

    def __init__(self, cascade: CascadeEstimator, bench: Workbench, index: int) -> None:
        self.cascade, self.table, self.source = cascade, cascade.table, cascade.source
        self.scene, self.lights, self.guide = bench.scene, bench.lights, bench.guide
        frame = self.scene.frame(index)
        self.camera, self.display = frame.camera, jnp.asarray(frame.image)
        kinds = ", ".join(type(light).__name__ for light in self.lights.lights)
        conditions = f"{kinds}; {len(self.scene.mesh.faces)} triangles; {self.guide.name} guide"
        self.keys = {stage: f"{stage} ({conditions})" for stage in self.STAGES}
        if any(key not in self.table.stages for key in self.keys.values()):
            calls = self._calls()
            time_stages(self.table, {self.keys[stage]: calls[stage] for stage in self.STAGES}, STAGE_REPEATS)
            save_table(self.table)
        times = [self._time(stage) for stage in self.STAGES]
        self.rest = Milliseconds(sum(time.median for time in times), sum(time.p95 for time in times))
        self.cost = dataclasses.replace(self.table.p95, fixed=self.rest.p95 + self.table.p95.fixed)

    def _time(self, stage: str) -> Milliseconds:
        return self.table.stages[self.keys[stage]]

    def _view(self) -> View:
        return View.of(self.display, self.scene.gbuffer(self.camera))

    def _calls(self) -> Mapping[str, Callable[[], Any]]:
        """Each stage by itself, as the pipeline runs it."""
        view, maps, schedule = (
            self._view(),
            self.scene.shadow_maps(self.lights, occluders="surface"),
            Schedule.preset("hyjax-scan-shadow"),
        )
        shaded, features = view.shade(self.lights, shadow_maps=maps), self.guide.features(self.display)
        return {
            "G-buffer": self._view,
            "guide": lambda: self.guide.features(self.display),
            "shading": lambda: shade_each(view.gbuffer, self.lights.lights),
            "visibility": lambda: visibilities(view.gbuffer, self.lights.lights, maps),
            "shadow pass": lambda: refine_visibility(shaded, features, schedule),
            "linear composite": lambda: composite_linear(view.frame, shaded, shaded.illuminance, shaded.visibility),
        }

    def predict(self, schedule: Schedule) -> Milliseconds:
        known = self.table.timed.get(self._key(schedule))
        if known is not None and not has_searched_form(schedule):
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
        return f"whole frame {schedule_key(schedule)} {self.keys['G-buffer']}"

    def _frame(self, schedule: Schedule) -> jax.Array:
        view = self._view()
        shaded = view.shade(self.lights, shadow_maps=self.scene.shadow_maps(self.lights, occluders="surface"))
        return relight(view, shaded, self.guide.features(self.display), schedule).image

    def parts(self) -> dict[str, float]:
        times = {stage: self._time(stage).p95 for stage in self.STAGES}
        times["diffusion"] = sum(self.cascade.parts().values())
        return dict(sorted(times.items(), key=lambda item: -item[1]))


def smallest_schedules(estimator: LatencyEstimator) -> list[Schedule]:
    """One step at each level of the table's factors alone, the fastest first, by the latency table."""
    singles = [guided_schedule([(factor, 1)], name=f"1 step at 1/{factor}") for factor in estimator.table.factors]
    return sorted(singles, key=lambda schedule: estimator.predict(schedule).p95)


def check_reachable(estimator: LatencyEstimator, milliseconds: float) -> None:
    """Raise `InputError` if even the smallest schedule, on the clock, takes longer than the budget."""
    cheapest = smallest_schedules(estimator)[:2]
    fastest = min(time.p95 for time in estimator.measure(cheapest, progress=False))
    if fastest > milliseconds:  # not to refuse for a bad moment that the table remembers
        fastest = min(time.p95 for time in estimator.measure(cheapest, again=True, progress=False))
    if fastest > milliseconds:
        parts = ", ".join(f"{name} {time:.2f} ms" for name, time in estimator.parts().items())
        raise InputError(
            f"budget {milliseconds:.3g} ms: out of reach on this device; the smallest reachable time (p95) is "
            f"{fastest:.2f} ms ({parts}); give at least --budget-ms {fastest * 1.05:.3g}, or a smaller --size"
        )
