"""Relit pictures of a scene, made anew only as far as a change reaches."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from hyjax.choices.table import CASCADES
from hyjax.configuration import Configuration
from hyjax.core.cascade import sampled_schedule
from hyjax.core.pyramid import downsample
from hyjax.core.schedule import Level, Schedule
from hyjax.exploration.kept_stages import KeptStages
from hyjax.light.photo_light import SurfaceLight, direct_channels
from hyjax.light.relit import Relit
from hyjax.light.setup import LightSetup, geometry_key, same_setup
from hyjax.light.view import View
from hyjax.pipeline import cascade_calls
from hyjax.scene.relighter import LitFrame, Relighter, refine
from hyjax.scene.scene import Scene
from hyjax.util.clock import StageClock
from hyjax.util.errors import InputError
from hyjax.util.programs import run_kept

MOST_STEPS, MOST_FINE_STEPS = 32, 8
"""Ends of the sliders of steps, but for levels that have more; steps at full size are dear."""
MOST_FILLED_STEPS = 64
"""Most steps that a level is filled up to; more cost more to run than to compile."""
FILLING_LAM = np.float32(1e-30)
"""λ of the steps that are filled up with: too small to change any value."""
KEPT_FRAMES = 4
"""Frames under lights that are kept: full and draft of two configurations."""
DRAFT_FACTOR = 2
"""Size of a frame over that of its draft."""
DRAFT_MAP_FACTOR = 4
"""Size of a shadow map over that of a draft's."""
DRAFT_VIEWS = 4
"""Views of a soft light in the shadow map of a draft."""
Lights = LightSetup | str
Stages = Iterator[tuple[str, Any]]
Ends = Mapping[str, Sequence[int]]
"""Cascade → ends of the sliders of its levels' steps."""


class DraftRelighter(Relighter):
    """Relighter that may take the light on the surface from another, so that no bounces are followed.

    Args:
        surface: light on the surface; None for that of the lights.
    """

    def __init__(
        self, place: Scene, lights: Lights, configuration: Configuration, surface: SurfaceLight | None
    ) -> None:
        self._given = surface
        super().__init__(place, lights, configuration)

    @property
    def surface_light(self) -> SurfaceLight | None:
        """Light on the surface, as far as the frames are divided by it."""
        return self._light()[-1]

    def _surface_light(self) -> SurfaceLight:
        return super()._surface_light() if self._given is None else self._given


class Superseded(Exception):
    """A newer picture was asked for."""


class Pictures:
    """Relit pictures of a scene; what the last changes left as it was is kept.

    A change of the cascades refines a kept frame again, whatever its lights cost. A picture is that of
    `Scene.relit`, to the pixel.

    `fills` is whether counts of steps are filled up, see `filled`: their programs are others than those of single
    pictures, and worth compiling only where counts are going to change.

    Args:
        superseded: asked between stages: whether a newer picture is wanted.
    """

    def __init__(self, scene: Scene, superseded: Callable[[], bool] = lambda: False) -> None:
        self.scene, self.fills, self._superseded = scene, False, superseded
        self._views: dict[tuple[int, int, int, str, bool], View] = {}
        self._relighters: list[tuple[Lights, Any, DraftRelighter]] = []
        self._whole: tuple[Any, Lights, LightSetup, SurfaceLight] | None = None  # choices, lights, placed, surface
        self._ends: dict[tuple[str, tuple[int, ...]], tuple[int, ...]] = {}
        self._frames: list[tuple[Relighter, int, bool, LitFrame]] = []
        self._run, self._run_draft = KeptStages(), KeptStages(draft=True)

    def relighter(
        self, lights: Lights, configuration: Configuration, surface: SurfaceLight | None = None
    ) -> DraftRelighter:
        """Relighter of lights; its configuration's cascades may be of an earlier change.

        Args:
            surface: light on the surface that is taken in the place of their own, for a draft.
        """
        key = light_key(configuration), id(surface)
        for place, (own, own_key, relighter) in enumerate(self._relighters):
            if own_key == key and same(own, lights):
                self._relighters.append(self._relighters.pop(place))
                return relighter
        made = DraftRelighter(self.scene, lights, configuration, surface)
        self._relighters = [*self._relighters, (lights, key, made)][-KEPT_FRAMES:]
        return made

    def knows(self, frame: int, lights: Lights, configuration: Configuration) -> bool:
        """Whether a frame under these lights is kept, so that its cascades alone are to be run."""
        key = light_key(configuration), id(None)
        known = [relighter for own, own_key, relighter in self._relighters if own_key == key and same(own, lights)]
        return any(relighter in known and index == frame for relighter, index, *_ in self._frames)

    def _brightened(
        self, frame: int, lights: LightSetup, configuration: Configuration, surface: Any
    ) -> LitFrame | None:
        """Frame of a kept draft under lights of other strengths, made as bright as these; None if there is none.

        Light is linear in strengths, and so are the cascades: factors of the colours leave these as they are.
        """
        key = light_key(configuration), id(surface)
        known = [relighter for _, own_key, relighter in self._relighters if own_key == key]
        for relighter, index, small, lit in reversed(self._frames):
            kept = small and relighter in known and index == frame
            factors = _factors(relighter.setup, lights) if kept else None
            if factors is not None:
                colors = np.asarray(lit.shaded.colors)
                direct = direct_channels(lights.lights, len(colors) < len(factors))
                colors = colors * factors[list(direct), None]
                return dataclasses.replace(lit, shaded=dataclasses.replace(lit.shaded, colors=colors))
        return None

    def lit(
        self,
        frame: int,
        lights: Lights,
        configuration: Configuration,
        clock: StageClock,
        surface: SurfaceLight | None = None,
        *,
        small: bool = False,
    ) -> LitFrame:
        """Frame under lights, ready to be refined; arguments as of `relighter`.

        Args:
            small: whether its picture is to be smaller, as a draft's.
        """
        with clock("lights"):
            relighter = self.relighter(lights, configuration, surface)
        for place, (own, index, kept_small, lit) in enumerate(self._frames):
            if own is relighter and (index, kept_small) == (frame, small):
                self._frames.append(self._frames.pop(place))
                return lit
        size = frame, configuration.scale, configuration.light.sampling, configuration.mode, small
        if size not in self._views:
            with clock("g-buffer"):
                opened = self.scene.frame(frame)
                gbuffer = relighter.gbuffer(opened.camera, rays=True)  # as of a single picture
            until_view = self._followed(relighter.stages(opened, gbuffer=gbuffer))
            self._views = {k: v for k, v in self._views.items() if k[0] == frame}
            view = clock.follow(until_view, until="view")
            if small and view.full is not None:
                half = downsample(view.full, DRAFT_FACTOR)
                view = dataclasses.replace(view, full=half, full_frame=None, factor=view.factor // DRAFT_FACTOR)
            self._views[size] = view
        lit = clock.follow(self._followed(relighter.stages(frame, view=self._views[size])), until="guide")
        self._frames = [*self._frames, (relighter, frame, small, lit)][-KEPT_FRAMES:]
        return lit

    def relit(
        self, frame: int, lights: Lights, configuration: Configuration, clock: StageClock, *, beside: bool = False
    ) -> Relit:
        """Relit frame.

        Args:
            beside: whether it is only shown beside another, whose bounces drafts keep.

        Raises:
            Superseded: a newer picture was asked for meanwhile.
        """
        lit = self.lit(frame, lights, configuration, clock)
        if not beside:
            own = self.relighter(lights, configuration)
            surface = own.surface_light
            self._whole = None if surface is None else (configuration.light, lights, own.setup, surface)
        relit: Relit = clock.follow(self._followed(refine(lit, self._as_run(configuration), run=self._run)))
        return relit

    def draft(
        self, frame: int, lights: Lights, configuration: Configuration, clock: StageClock
    ) -> Float[Array, "h w 3"]:
        """Relit picture at half the size, linear, with bounces of the last whole picture.

        Named lights have no bounces but their own. Lights that have other places than there throw coarser shadows;
        of the others shadow maps are kept. Where a kept draft differs in strengths alone, its light is scaled.
        """
        surface, moved = None, False
        if self._whole is not None and self._whole[0] == configuration.light:
            _, given, setup, found = self._whole
            if isinstance(lights, LightSetup):
                surface, moved = found, _places(lights) != _places(setup)
            elif given == lights:
                surface = found
        small = draft_of(self._as_run(configuration), bounces=not moved)
        lit = self._brightened(frame, lights, small, surface) if isinstance(lights, LightSetup) else None
        lit = lit or self.lit(frame, lights, small, clock, surface, small=True)
        stages = refine(lit, small, run=self._run_draft)
        picture: Float[Array, "h w 3"] = clock.follow(stages, until="composite")
        return picture

    def levels(
        self, frame: int, lights: Lights, configuration: Configuration, clock: StageClock
    ) -> list[tuple[str, Float[Array, "h w 3"]]]:
        """Light after each level of the cascade, without shadows, over the reference."""
        if configuration.mode == "paper":
            raise InputError("levels: mode 'paper' is shown by its stages only")
        lit, found = self.lit(frame, lights, configuration, clock), []
        own, weights = self._as_run(configuration).sampled(), np.asarray(lit.shaded.colors)
        for count, level in enumerate(own.schedule.levels, 1):
            part = dataclasses.replace(own.schedule, levels=own.schedule.levels[:count])
            (function, *arguments), _ = cascade_calls(lit.shaded, lit.features, part, own.shadow_schedule)
            each = np.asarray(run_kept(function, *arguments))[..., : len(weights)]
            found.append(
                (
                    f"after 1/{level.factor * configuration.light.sampling}",
                    each @ weights / np.asarray(lit.shaded.reference_lux),
                )
            )
        return found

    def _as_run(self, configuration: Configuration) -> Configuration:
        """Configuration with the default's names of cascades, which programs depend on, too."""
        usual = Configuration()
        parts = ((part, getattr(configuration, part), getattr(usual, part).name) for part in CASCADES)
        named = {part: dataclasses.replace(schedule, name=name) for part, schedule, name in parts}
        renamed = dataclasses.replace(configuration, **named)
        return filled(renamed, self.ends(configuration)) if self.fills else renamed

    def ends(self, configuration: Configuration) -> Ends:
        """Ends of the sliders of steps; one that a level of more steps has raised stays."""
        found = {}
        for part, ends in slider_ends(configuration).items():
            key = part, tuple(level.factor for level in getattr(configuration, part).levels)
            found[part] = self._ends[key] = tuple(map(max, ends, self._ends.get(key, ends)))
        return found

    def _followed(self, stages: Stages) -> Stages:
        for stage in stages:
            if self._superseded():
                raise Superseded
            yield stage


def light_key(configuration: Configuration) -> Any:
    """Choices that the light of a frame depends on: all but those of the cascades."""
    return tuple(getattr(configuration, part) for part in ("mode", "scale", "light", "shadows", "guide"))


def _places(setup: LightSetup) -> list[Any]:
    """All that shadow maps depend on, of each light."""
    return [geometry_key(light) for light in setup.lights]


def _factors(before: LightSetup, after: LightSetup) -> np.ndarray | None:
    """Factor of each light's strength; None for set-ups that differ in more, or in lights that fall everywhere."""
    alike = before.reference_lux == after.reference_lux and dict(before.existing) == dict(after.existing)
    if not alike or _places(before) != _places(after):
        return None
    factors = []
    for old, new in zip(before.lights, after.lights):
        was, strength = (float(np.asarray(getattr(light, light.STRENGTH))) for light in (old, new))
        other = was <= 0 or (old.UNIFORM and was != strength)
        if other or not np.array_equal(old.color, new.color):
            return None
        factors.append(strength / was)
    return np.asarray(factors, np.float32)


def same(a: Lights, b: Lights) -> bool:
    """Whether two set-ups, or their names, are the same."""
    if isinstance(a, str) or isinstance(b, str):
        return a == b if isinstance(a, str) and isinstance(b, str) else False
    return a is b or same_setup(a, b)


def filled(configuration: Configuration, ends: Ends) -> Configuration:
    """Configuration with levels filled up by steps that change nothing: a slider's counts share a program.

    >>> [level.steps for level in filled(Configuration(), slider_ends(Configuration())).schedule.levels]
    [32, 32, 32]
    """
    parts: Any = {part: _filled(getattr(configuration, part), most) for part, most in ends.items()}
    return dataclasses.replace(configuration, **parts)


def slider_ends(configuration: Configuration) -> dict[str, tuple[int, ...]]:
    """Most steps that the slider of each level has, by cascade."""

    def end(level: Level) -> int:
        return max(MOST_FINE_STEPS if level.factor == 1 else MOST_STEPS, level.steps)

    return {part: tuple(map(end, getattr(configuration, part).levels)) for part in CASCADES}


def _filled(schedule: Schedule, ends: Sequence[int]) -> Schedule:
    if not any(level.steps for level in schedule.levels):
        return schedule  # no cascade at all
    return dataclasses.replace(schedule, levels=tuple(map(_filled_level, schedule.levels, ends)))


def _filled_level(level: Level, end: int) -> Level:
    sizes = np.asarray(level.step_sizes, np.float32)
    if sizes.max(initial=0.0) >= 0.25:  # a cycle is stable only as it is
        return level
    filling = np.full(max(0, min(end, MOST_FILLED_STEPS) - len(sizes)), FILLING_LAM)
    return dataclasses.replace(level, step_sizes=np.concatenate([sizes, filling]))


def draft_of(configuration: Configuration, *, bounces: bool = True) -> Configuration:
    """Configuration of a draft: worked at half the size, with levels of the same cells, and coarser shadows.

    Where bounces are followed with the photo's light, shadows stay: that needs the whole shadow maps anyway.
    """
    own = configuration.sampled()
    schedules: dict[str, Any] = {part: sampled_schedule(getattr(own, part), DRAFT_FACTOR) for part in CASCADES}
    shadows = configuration.shadows
    if configuration.light.photo_light != "divided" or not bounces:
        shadows = shadows.replace(
            map_scale=max(0.05, shadows.map_scale / DRAFT_MAP_FACTOR),
            views=DRAFT_VIEWS if shadows.views is None else min(shadows.views, DRAFT_VIEWS),
        )
    return dataclasses.replace(own, scale=own.scale * DRAFT_FACTOR, shadows=shadows, **schedules)
