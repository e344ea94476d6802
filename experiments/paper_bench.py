"""A capture on its rough and on its accurate surface: frames relit by every method, and judged."""

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from tqdm import tqdm

import hyjax
from experiments.command import RunConfig, Start
from experiments.judging import check_size, judge, regions
from experiments.paper_view import View, linear_filter, mean_colour, multiplied, with_kappa
from experiments.records import Results
from experiments.references import open_reference
from hyjax.core.schedule import PAPER_KAPPA, Schedule
from hyjax.data.builtin_room import load_room
from hyjax.data.capture import Capture
from hyjax.data.frames import fit, select_frames
from hyjax.data.registry import open_capture
from hyjax.guide.choose import RGB, FrameGuide, open_guide
from hyjax.light.relit import Relit
from hyjax.light.setup import LightSetup
from hyjax.light.shadow_map import ShadowMap
from hyjax.metrics import LpipsWeights
from hyjax.pipeline import Mode, TemporalFilter
from hyjax.relighting.settings import Renderer
from hyjax.scene.blender import BlenderRenderer
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.scene.surfaces import rough_mesh
from hyjax.util.errors import InputError

BENCHMARKS = {
    "mesh error correction": "center-point",
    "multi-lighting consistency": "two-colors",
    "relighting fidelity": "two-colors",
}
"""Benchmark → its lights."""
GROUPS = ("display values", "light")
"""Quantities that the filter is multiplied with."""
METHODS: dict[Mode, str] = {"paper": "paper's method", "linear": "ours"}
"""Mode of the pipeline → how its filter is called."""
OWN_GROUP: dict[Mode, str] = dict(zip(METHODS, GROUPS))
"""Quantity that each mode is meant to multiply its filter with."""
KAPPA: dict[Mode, float | None] = {"paper": PAPER_KAPPA, "linear": None}
"""κ of each mode: the best for the RGB guide on tuning frames; None for the schedule's own."""
PointPlace = Literal["room", "view"]
"""Place of the first benchmark's lamp: the middle of the room, as in the paper, or near the surfaces in view."""
RAW_SCHEDULE = Schedule.uniform([(16, 1)])
"""Schedule for the accurate surface, of which only the raw filter is looked at."""
SHEET = ("frame", "bare mesh", "paper's method", "ours", "accurate surface", "relied on")


class Bench:
    """Both surfaces of a capture under each benchmark's lights; a context manager, for Blender's sake.

    Args:
        capture: frames.
        schedule: of the paper's mode, but for its κ.
        mesh: the rough surface, as `surface_of` takes it; the capture's own or else a simulated scan if None.
        reference: the accurate surface, as `open_reference` takes it.
        size: pixels a side.
        seed: of the simulated scan.
        renderer: what shades the surfaces.
        guide: what guides the diffusion.
        kappa: mode → κ, of features as the guide gives them; None for the schedule's own.
        own: schedule of our mode; the preset `hyjax` if None.
        point: place of the first benchmark's light.

    Raises:
        InputError: any of these cannot be used.
    """

    def __init__(
        self,
        capture: Capture,
        schedule: Schedule,
        mesh: str | None = None,
        reference: str | None = None,
        size: int = 512,
        seed: int = 0,
        renderer: Renderer = "shadow_map",
        guide: FrameGuide = RGB,
        kappa: Mapping[Mode, float | None] = KAPPA,
        own: Schedule | None = None,
        point: PointPlace = "room",
    ) -> None:
        check_size(size)
        for mode, value in kappa.items():
            if value is not None and not 0 < value < float("inf"):
                raise InputError(f"kappa of {METHODS[mode]}: {value:g} given; it must be a number > 0")
        self.guide, self.kappa = guide, kappa
        settings = SceneSettings(mesh=mesh or rough_mesh(capture), seed=seed, size=str(size))
        self.scene = Scene.open(settings, capture=capture)
        self.capture, self.source = capture, self.scene.source
        self.schedules: dict[Mode, Schedule] = {"paper": schedule, "linear": own or Schedule.preset("hyjax")}
        self.rough, self.reference = self.scene.caster, open_reference(capture, reference)
        self.setups = {name: self.scene.lights(name) for name in dict.fromkeys(BENCHMARKS.values())}
        if point == "room":
            self.setups["center-point"] = in_the_middle(self.setups["center-point"], self.scene.mesh.bounds)
        self._stack, self._blender = contextlib.ExitStack(), []
        if renderer == "blender":
            lights = [light for setup in self.setups.values() for light in setup.lights]
            for geometry in (self.scene.mesh, self.reference.geometry):
                made = BlenderRenderer(geometry, lights, shadows=False)
                self._blender.append(self._stack.enter_context(made))

    def __enter__(self) -> "Bench":
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def row(self, index: int, weights: LpipsWeights) -> dict[str, Any]:
        """Scores of one frame, or a row without any if it sees no surface."""
        view = self.view(index)
        base = {"frame": view.frame.name, "index": index}
        if view.blind:
            return base | {"note": "no ray met the surface"}
        where = regions(view.rough, view.accurate)
        scores: dict[str, Any] = {}
        relit = {lights: self.pictures(view, lights) for lights in self.setups}
        for benchmark, lights in BENCHMARKS.items():
            fidelity = benchmark == "relighting fidelity"
            for group, pictures in relit[lights].items():
                target = pictures["accurate surface"] if fidelity else view.display
                judged = {name: p for name, p in pictures.items() if not (fidelity and name == "accurate surface")}
                found = judge(judged, target, where, weights, view.valid if fidelity else None)
                scores.setdefault(benchmark, {})[group] = found
        shares = {name: float(mask.mean()) for name, mask in where.items()}
        relied = {name: float(view.valid[mask].mean()) for name, mask in where.items() if mask.any()}
        meshes = f"{self.source} against {self.reference.description}"
        return base | {"meshes": meshes, "shares": shares, "relied on": relied, "scores": scores}

    def view(self, index: int) -> View:
        """A frame with both surfaces as its camera sees them."""
        frame = self.capture[index]
        fitted = fit(frame, self.scene.size)
        seen = [gbuffer(fitted.camera) for gbuffer in (self.rough.gbuffer, self.reference.gbuffer)]
        shading = []
        for k, blender in enumerate(self._blender):
            rendering = blender.render(fitted.camera)
            seen[k] = rendering.hit_by_both(seen[k])
            shading.append(jnp.asarray(rendering.shading))
        valid = self.reference.reliable(frame, fitted.camera, seen[1])
        display = jnp.asarray(fitted.image)
        return View(frame, display, self.guide.features(display), fitted.camera, *seen, valid, shading)

    def views(self, indices: Sequence[int], doing: str) -> Iterator[View]:
        """The views of frames that see both surfaces, with a progress bar.

        Raises:
            InputError: at the end, if there was none.
        """
        found = False
        for index in tqdm(indices, desc=doing, unit="frame"):
            view = self.view(index)
            if not view.blind:
                found = True
                yield view
        if not found:
            raise self.unseen()

    def unseen(self) -> InputError:
        """Error for a capture of which no frame sees both surfaces."""
        return InputError(f"{self.capture.name}: no ray of any frame met both surfaces; are they in one world?")

    def pictures(self, view: View, lights: str) -> dict[str, dict[str, Float[Array, "h w 3"]]]:
        """Group → method → the relit frame, display values.

        All filters are multiplied both ways, so that what refining does is not mixed up with what multiplying does.
        """
        paper, ours = (self.relight(view, lights, mode, self.schedules[mode]) for mode in METHODS)
        filters = {
            "bare mesh": ours.shading,
            METHODS["paper"]: linear_filter(paper, "paper"),
            METHODS["linear"]: linear_filter(ours, "linear"),
            "accurate surface": self.relight(view, lights, "linear", RAW_SCHEDULE, accurate=True).shading,
        }
        made = {}
        for group in GROUPS:
            flat = {"mean colour": mean_colour(view, filters["bare mesh"], group)}
            every = filters | flat
            order = ("bare mesh", "mean colour", *METHODS.values(), "accurate surface")
            made[group] = {name: multiplied(view, every[name], group) for name in order}
        return made

    def relight(
        self,
        view: View,
        lights: str,
        mode: Mode,
        schedule: Schedule,
        *,
        kappa: float | None = None,
        accurate: bool = False,
        shadow_maps: Sequence[ShadowMap | None] | None = None,
        temporal_filter: TemporalFilter | None = None,
    ) -> Relit:
        """A frame on the rough surface, or on the accurate one. κ is the bench's for the mode unless given.

        See `own_kappa`.
        """
        seen = hyjax.View.of(view.display, view.accurate if accurate else view.rough)
        own = self.own_kappa(schedule, mode) if kappa is None else with_kappa(schedule, kappa)
        shaded = self.shaded(view, lights, accurate=accurate, shadow_maps=shadow_maps)
        return hyjax.relight(seen, shaded, view.guide, own, temporal_filter=temporal_filter, mode=mode)

    def shaded(
        self,
        view: View,
        lights: str,
        *,
        accurate: bool = False,
        shadow_maps: Sequence[ShadowMap | None] | None = None,
    ) -> hyjax.Shaded:
        """Light of a set-up on the rough surface, or on the accurate one."""
        setup, gbuffer = self.setups[lights], (view.accurate if accurate else view.rough)
        if not view.shading:
            return hyjax.View.of(view.display, gbuffer).shade(setup, shadow_maps=shadow_maps)
        names = list(self.setups)
        first = sum(len(self.setups[name].lights) for name in names[: names.index(lights)])
        illuminance = view.shading[accurate][..., first : first + len(setup.lights)]
        return hyjax.Shaded.of(setup, illuminance, jnp.ones_like(illuminance), gbuffer.hit)

    def own_kappa(self, schedule: Schedule, mode: Mode) -> Schedule:
        """The schedule with the bench's κ for the mode, if it has one."""
        kappa = self.kappa[mode]
        return schedule if kappa is None else with_kappa(schedule, kappa)

    def sheet_row(self, index: int) -> tuple[str, list[np.ndarray]] | None:
        """Pictures of a frame under two colours; None if it sees no surface."""
        view = self.view(index)
        if view.blind:
            return None
        pictures = self.pictures(view, "two-colors")
        shown = [pictures["light"][name] for name in ("bare mesh", METHODS["linear"], "accurate surface")]
        shown.insert(1, pictures["display values"][METHODS["paper"]])
        relied = np.repeat(view.valid[..., None].astype(np.float32), 3, axis=-1)
        return view.frame.name, [*(np.asarray(x) for x in (view.display, *shown)), relied]


@dataclasses.dataclass(frozen=True, kw_only=True)
class BenchConfig(RunConfig):
    """Options of every experiment on a `Bench`."""

    capture: Path | None = None
    """Folder of a capture. Default: the built-in room."""
    mesh: str | None = None
    """The rough surface, see `hyjax relight --mesh`. Default: the capture's own mesh, else a simulated scan."""
    reference: str | None = None
    """The accurate surface: true, laser, fused or a mesh file. Default: the first of these that there is."""
    guide: str = "rgb"
    """Guide of the diffusion, see `hyjax relight --guide`."""
    size: int = 512
    """Pixels a side."""
    seed: int = 1
    """Of the built-in room and of the simulated scan."""
    point: PointPlace = "room"
    """Where the light of mesh error correction stands: in the middle of the room, as in the paper, or near the
    surfaces that the cameras look at."""

    def start(self, start: Start) -> tuple[Capture, Results]:
        """The capture, and the results in a folder of its name."""
        capture = load_room(self.seed) if self.capture is None else open_capture(self.capture)
        return capture, start(capture.name)

    def bench(self, capture: Capture, schedule: Schedule, renderer: Renderer = "shadow_map") -> Bench:
        """Both surfaces of the capture."""
        surfaces = self.mesh, self.reference, self.size, self.seed
        ours = open_guide(self.guide), self.kappas, self.preset_of_ours
        return Bench(capture, schedule, *surfaces, renderer, *ours, self.point)

    @property
    def kappas(self) -> Mapping[Mode, float | None]:
        """Mode → κ."""
        return KAPPA

    @property
    def preset_of_ours(self) -> Schedule:
        """Schedule of our mode."""
        return Schedule.preset("hyjax")


@dataclasses.dataclass(frozen=True, kw_only=True)
class KappaConfig(BenchConfig):
    """Settings with a κ for each mode."""

    kappa: float | None = None
    """κ of our mode, for this guide (`guide_worth` finds it). Default: the schedule's own."""
    paper_kappa: float = PAPER_KAPPA
    """κ of the paper's mode."""
    ours: str = "hyjax"
    """Named schedule of our mode."""

    @property
    def kappas(self) -> Mapping[Mode, float | None]:
        return {"paper": self.paper_kappa, "linear": self.kappa}

    @property
    def preset_of_ours(self) -> Schedule:
        return Schedule.preset(self.ours)


def in_the_middle(setup: LightSetup, bounds: Float[np.ndarray, "2 3"]) -> LightSetup:
    """The set-up with its lamp in the middle of a box, in the world's axes and metres."""
    (lamp,) = setup.lights
    return dataclasses.replace(setup, lights=(dataclasses.replace(lamp, position=bounds.mean(axis=0)),))


def reported(capture: Capture, frames: str | None = None) -> list[int]:
    """Frames to report on: those asked for, else those that no parameter was chosen on.

    Raises:
        InputError: see `select_frames`.
    """
    if frames is not None:
        return select_frames(frames, len(capture))
    quarter = len(capture) - max(1, len(capture) // 4)
    return list(range(quarter if capture.reference() is None else 0, len(capture)))
