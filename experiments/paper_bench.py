"""A capture on its rough and on its accurate surface: frames relit by every method, and judged."""

import contextlib
import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

import hyjax
from experiments.judging import judge, regions
from experiments.references import open_reference
from hyjax.data.capture import Capture, Frame
from hyjax.data.frames import fit
from hyjax.data.light_setups import named_setup, survey_capture
from hyjax.data.surfaces import rough_mesh, surface_of
from hyjax.gbuffer import GBuffer
from hyjax.metrics import LpipsWeights
from hyjax.pipeline import Mode, Relit
from hyjax.scene.blender import BlenderRenderer
from hyjax.scene.camera import Camera
from hyjax.scene.raycast import RayCaster
from hyjax.schedule import DEFAULT_KAPPA, PAPER_KAPPA, Schedule
from hyjax.shadow import ShadowMap

BENCHMARKS = {
    "mesh error correction": "center-point",
    "multi-lighting consistency": "two-colors",
    "relighting fidelity": "two-colors",
}
"""Benchmark → its lights."""
GROUPS: dict[str, Mode] = {"display values": "paper", "light": "hyjax"}
"""What the filter is multiplied with → mode of the pipeline."""
OURS: dict[Mode, str] = {"paper": "paper's method", "hyjax": "ours"}
KAPPA: dict[Mode, float] = {"paper": PAPER_KAPPA, "hyjax": DEFAULT_KAPPA}
ANY = Schedule.uniform([(16, 1)])
"""For the accurate surface, of which only the raw filter is looked at."""
SHEET = ("frame", "bare mesh", "paper's method", "ours", "accurate surface", "relied on")


class Bench:
    """Both surfaces of a capture under each benchmark's lights; a context manager, for Blender's sake.

    Args:
        capture: frames.
        schedule: of the cascade; κ is the default of each mode.
        mesh: the rough surface, as `surface_of` takes it; the capture's own or else a simulated scan if None.
        reference: the accurate surface, as `open_reference` takes it.
        size: pixels a side.
        seed: of the simulated scan.
        renderer: what shades the surfaces.
    """

    def __init__(
        self,
        capture: Capture,
        schedule: Schedule,
        mesh: str | None = None,
        reference: str | None = None,
        size: int = 512,
        seed: int = 0,
        renderer: Literal["hyjax", "blender"] = "hyjax",
    ) -> None:
        self.source, rough = surface_of(capture, mesh or rough_mesh(capture), seed=seed)
        self.capture, self.schedule, self.size = capture, schedule, (size, size)
        self.rough, self.reference = RayCaster(rough), open_reference(capture, reference)
        stage = survey_capture(self.rough, capture)
        self.setups = {name: named_setup(name, stage) for name in dict.fromkeys(BENCHMARKS.values())}
        self._stack, self._blender = contextlib.ExitStack(), []
        if renderer == "blender":
            lights = [light for setup in self.setups.values() for light in setup.lights]
            for geometry in (rough, self.reference.geometry):
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
        for benchmark, lights in BENCHMARKS.items():
            fidelity = benchmark == "relighting fidelity"
            for group, mode in GROUPS.items():
                pictures = self.pictures(view, lights, mode)
                target = pictures.pop("accurate surface") if fidelity else view.display
                found = judge(pictures, target, where, weights, view.valid if fidelity else None)
                scores.setdefault(benchmark, {})[group] = found
        shares = {name: float(mask.mean()) for name, mask in where.items()}
        shares["relied on"] = float(view.valid.mean())
        meshes = f"{self.source} against {self.reference.description}"
        return base | {"meshes": meshes, "shares": shares, "scores": scores}

    def view(self, index: int) -> "View":
        """A frame with what its camera sees of both surfaces."""
        frame = self.capture[index]
        fitted = fit(frame, self.size)
        seen = [gbuffer(fitted.camera) for gbuffer in (self.rough.gbuffer, self.reference.gbuffer)]
        shading = []
        for k, blender in enumerate(self._blender):
            rendering = blender.render(fitted.camera)
            # At a silhouette the two may disagree by a pixel; where one sees nothing, nothing is known.
            seen[k] = dataclasses.replace(seen[k], hit=seen[k].hit & rendering.hit)
            shading.append(jnp.asarray(rendering.shading))
        valid = self.reference.reliable(frame, fitted.camera, seen[1])
        return View(frame, jnp.asarray(fitted.image), fitted.camera, *seen, valid, shading)

    def pictures(self, view: "View", lights: str, mode: Mode) -> dict[str, Float[Array, "h w 3"]]:
        """The relit frame by every method, display values."""
        rough = self.relight(view, lights, mode, self.schedule)
        accurate = self.relight(view, lights, mode, ANY, accurate=True)
        linear, hit = hyjax.to_linear(view.display), view.rough.hit[..., None]
        mean = jnp.sum(rough.shading * hit, axis=(0, 1)) / jnp.maximum(jnp.sum(hit), 1)
        flat = view.display * mean if mode == "paper" else hyjax.to_display(linear * mean)
        return {
            "bare mesh": hyjax.to_display(rough.unrefined),
            "mean colour": jnp.clip(flat, 0.0, 1.0),
            OURS[mode]: hyjax.to_display(rough.image),
            "accurate surface": hyjax.to_display(accurate.unrefined),
        }

    def relight(
        self,
        view: "View",
        lights: str,
        mode: Mode,
        schedule: Schedule,
        *,
        accurate: bool = False,
        shadow_maps: Sequence[ShadowMap | None] | None = None,
    ) -> Relit:
        """A frame on the rough surface, or on the accurate one. The schedule's κ is the mode's."""
        setup = self.setups[lights]
        gbuffer, shading = (view.accurate if accurate else view.rough), None
        if view.shading:
            names = list(self.setups)
            first = sum(len(self.setups[name].lights) for name in names[: names.index(lights)])
            shading = view.shading[accurate][..., first : first + len(setup.lights)]
        return hyjax.relight(
            hyjax.to_linear(view.display),
            gbuffer,
            setup.lights,
            view.display,
            with_kappa(schedule, KAPPA[mode]),
            shading=shading,
            shadow_maps=shadow_maps,
            reference_lux=setup.reference_lux,
            mode=mode,
        )

    def sheet_row(self, index: int) -> tuple[str, list[np.ndarray]] | None:
        """Pictures of a frame under two colours; None if it sees no surface."""
        view = self.view(index)
        if view.blind:
            return None
        paper, ours = (self.pictures(view, "two-colors", mode) for mode in GROUPS.values())
        relied = np.repeat(view.valid[..., None].astype(np.float32), 3, axis=-1)
        relit = ours["bare mesh"], paper[OURS["paper"]], ours[OURS["hyjax"]], ours["accurate surface"]
        return view.frame.name, [*(np.asarray(x) for x in (view.display, *relit)), relied]


def with_kappa(schedule: Schedule, kappa: float) -> Schedule:
    """The schedule with one κ for all levels."""
    levels = tuple(dataclasses.replace(level, kappa=kappa) for level in schedule.levels)
    return dataclasses.replace(schedule, levels=levels)


@dataclasses.dataclass(frozen=True)
class View:
    """One frame, at the size that is worked at.

    Attributes:
        frame: as captured.
        display: its picture.
        camera: of `display`.
        rough: what the camera sees of the rough surface.
        accurate: and of the accurate one.
        valid: where the accurate one is relied on.
        shading: lux on both from the lights of all set-ups, if Blender has rendered it.
    """

    frame: Frame
    display: Float[Array, "h w 3"]
    camera: Camera
    rough: GBuffer
    accurate: GBuffer
    valid: Bool[np.ndarray, "h w"]
    shading: Sequence[Float[Array, "h w l"]] = ()

    @property
    def blind(self) -> bool:
        return not (bool(self.rough.hit.any()) and bool(self.valid.any()))
