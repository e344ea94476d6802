"""What a schedule is judged on: frames of a capture, lit on a rough mesh, with the filter they should have had."""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from jaxtyping import Array, Bool, Float
from skimage.metrics import peak_signal_noise_ratio, structural_similarity
from tqdm import tqdm

from hyjax.color import to_display, to_linear
from hyjax.data.capture import Capture, Frame
from hyjax.data.frames import fit
from hyjax.data.light_file import LightSetup
from hyjax.errors import InputError
from hyjax.losses import filter_loss
from hyjax.refine import cascade_known
from hyjax.scene.raycast import RayCaster
from hyjax.schedule import Schedule
from hyjax.shading import colored, shade_each
from hyjax.tuning.result import Scores

CONVERGED = "naive-1000"
"""Stands in for the truth where there is no better mesh: what the paper's cascade approximates."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """One frame, ready to be refined and judged.

    Attributes:
        shading: what the cascade repairs: lux of each light on the rough mesh, without shadows.
        known: where the rough mesh has a surface.
        guide: features of the frame.
        frame: camera picture, linear.
        colors: from lights to the filter: each light's colour, divided by the reference illuminance.
        target: the filter as it should be, linear.
        valid: where `target` means anything.
    """

    shading: Float[Array, "h w l"]
    known: Bool[Array, "h w 1"]
    guide: Float[Array, "h w f"]
    frame: Float[Array, "h w 3"]
    colors: Float[Array, "l 3"]
    target: Float[Array, "h w 3"]
    valid: Bool[Array, "h w"]


class Workbench:
    """A capture under lights, on a rough mesh and on an accurate one.

    Args:
        capture: frames with poses.
        rough: the mesh that has to be made do with.
        accurate: the mesh that the target is shaded from; None to aim at the converged diffusion of the rough one.
        setup: lights.
        size: (height, width) to work at; None as captured.
    """

    def __init__(
        self,
        capture: Capture,
        rough: trimesh.Trimesh,
        accurate: trimesh.Trimesh | None,
        setup: LightSetup,
        size: tuple[int, int] | None = (512, 512),
    ) -> None:
        self.capture, self.setup, self.size = capture, setup, size
        self.rough = RayCaster(rough)
        self.accurate = None if accurate is None else RayCaster(accurate)

    def frame(self, index: int) -> Frame:
        return fit(self.capture[index], self.size)

    def case(self, index: int) -> Case | None:
        """Frame `index` as a case; None if no ray meets the rough mesh or none meets the accurate one.

        Raises:
            InputError: the frame cannot be read.
        """
        frame = self.frame(index)
        seen = self.rough.gbuffer(frame.camera)
        truth = None if self.accurate is None else self.accurate.gbuffer(frame.camera)
        if not bool(seen.hit.any()) or (truth is not None and not bool(truth.hit.any())):
            return None
        guide = jnp.asarray(frame.image)
        lights = tuple(self.setup.lights)
        shading, known = shade_each(seen, lights), seen.hit[..., None]
        colors = colored(jnp.eye(len(lights))[None], lights)[0] / self.setup.reference_lux
        if truth is None:
            target = cascade_known(shading, known, guide, Schedule.preset(CONVERGED))
            valid = jnp.ones_like(seen.hit)
        else:
            target, valid = shade_each(truth, lights), truth.hit
        return Case(shading, known, guide, to_linear(guide), colors, mix(target, colors), valid)

    def cases(self, indices: Sequence[int], what: str, progress: bool = True) -> tuple[list[Case], list[str]]:
        """The frames that make cases, and the names of those that see no surface.

        Raises:
            InputError: a frame cannot be read, or none sees any surface.
        """
        cases, blind = [], []
        for index in tqdm(indices, desc=f"{what} frames", unit="frame", disable=not progress):
            case = self.case(index)
            if case is None:
                blind.append(self.capture[index].name)
            else:
                cases.append(case)
        if not cases and indices:
            raise InputError(
                f"{self.capture.name}: no ray of any of {len(indices)} {what} frames met the mesh; are the mesh "
                "and the poses in the same coordinates (metres, camera-to-world)?"
            )
        return cases, blind


def mix(channels: Float[Array, "h w l"], colors: Float[Array, "l 3"]) -> Float[Array, "h w 3"]:
    """A channel for each light → the filter."""
    return sum(channels[..., k, None] * colors[k] for k in range(colors.shape[0]))  # type: ignore[return-value]


@jax.jit
def refined_filter(case: Case, schedule: Schedule) -> Float[Array, "h w 3"]:
    """The filter that a schedule makes of the case: exactly what `relight` runs."""
    return mix(cascade_known(case.shading, case.known, case.guide, schedule), case.colors)


@jax.jit
def _judge(case: Case, relight_filter: Float[Array, "h w 3"]) -> tuple[Array, Array, Array]:
    loss = filter_loss(relight_filter, case.target, case.frame, case.valid)
    return loss, to_display(relight_filter * case.frame), to_display(case.target * case.frame)


def scores(cases: Sequence[Case], filters: Sequence[Float[Array, "h w 3"]]) -> Scores:
    """Loss, PSNR and SSIM of the relit frames, where the target is known; the mean over all cases."""
    rows = []
    for case, relight_filter in zip(cases, filters, strict=True):
        loss, relit, target = (np.asarray(x) for x in _judge(case, relight_filter))
        valid = np.asarray(case.valid)
        with np.errstate(divide="ignore"):  # equal pictures: infinite PSNR
            psnr = peak_signal_noise_ratio(target[valid], relit[valid], data_range=1.0)
        _, ssim = structural_similarity(target, relit, channel_axis=-1, data_range=1.0, full=True)
        rows.append((float(loss), float(psnr), float(ssim[valid].mean())))
    return Scores(*(float(x) for x in np.mean(rows, axis=0)))
