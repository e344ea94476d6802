"""Offline rendering of shading and shadows by Blender's Cycles, in place of our own.

The paper's offline results were rendered in Blender, with virtual lights put right onto meshes and point clouds.
Here Cycles traces one light at a time over a white diffuse surface, without any bounce: the result of
`hyjax.light.shading` and `hyjax.light.shadow_map` from the G-buffer, but with every ray
traced, so that no shadow map limits it.

Blender runs in a process of its own, for as long as a `BlenderRenderer` is open: its wheels are each for one
version of Python (that for 3.11 also for an older NumPy than ours), bring libraries of their own and print as they
please.
"""

import contextlib
import dataclasses
import importlib.util
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from jaxtyping import Bool, Float

from hyjax.geometry.camera import Camera
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Light
from hyjax.light.kinds.emitter import Emitter
from hyjax.light.setup import LightSetup
from hyjax.light.shaded import Shaded
from hyjax.light.view import View
from hyjax.util.errors import InputError
from hyjax.util.images import read_image

WORKER = Path(__file__).with_name("blender_worker.py")
ANSWER = "@hyjax "
"""Prefix of the worker's lines of answer."""


@dataclasses.dataclass(frozen=True)
class Rendering:
    """Light on one view, rendered by Cycles.

    Attributes:
        shading: lux of each light on the visible surface, without shadows; zero where there is none.
        visibility: unshadowed share of it, in [0, 1]; 1 where there is no light to lose.
        depth: distance along the camera's axis in metres; zero where no surface was hit.
        hit: whether the pixel's ray met the surface.
    """

    shading: Float[np.ndarray, "h w l"]
    visibility: Float[np.ndarray, "h w l"]
    depth: Float[np.ndarray, "h w"]
    hit: Bool[np.ndarray, "h w"]

    def shade(self, view: View, setup: LightSetup) -> tuple[View, Shaded]:
        """Shade a view, with misses wherever Cycles has one: at borders the two may disagree."""
        view = dataclasses.replace(view, gbuffer=self.hit_by_both(view.gbuffer))
        illuminance, visibility = jnp.asarray(self.shading), jnp.asarray(self.visibility)
        return view, Shaded.of(setup, illuminance, visibility, view.gbuffer.hit)

    def hit_by_both(self, gbuffer: GBuffer) -> GBuffer:
        """G-buffer with misses wherever Cycles has one."""
        return dataclasses.replace(gbuffer, hit=gbuffer.hit & self.hit)


class BlenderRenderer:
    """Scene in a process of Blender, as a context manager.

    Args:
        mesh: shaded by its vertex normals.
        lights: at least one, of any kinds.
        shadows: whether lights cast shadows; without, `visibility` is 1 and costs nothing.
        samples: rays per pixel to a light with an extent. A light without needs one, and is exact.
    """

    def __init__(
        self,
        mesh: trimesh.Trimesh,
        lights: Sequence[Light],
        *,
        shadows: bool = True,
        samples: int = 32,
    ) -> None:
        if not lights:
            raise InputError("blender: no lights; give at least one")
        if samples < 1:
            raise InputError(f"blender: samples must be at least 1, got {samples}")
        python = blender_python()
        vertices = np.asarray(mesh.vertices)
        # Cycles computes in float32, so everything is moved to the middle of the scene.
        self._center = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        self._lights, self._shadows, self._samples = lights, shadows, samples
        self._emitters = [None if light.UNIFORM else light.emitter() for light in lights]
        for light, emitter in zip(lights, self._emitters, strict=True):
            if emitter is None and not light.UNIFORM:
                raise InputError(f"blender: cannot render a {type(light).__name__}; its kind has no emitter")
        with contextlib.ExitStack() as stack:
            self._folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hyjax-blender-")))
            described = [emitter and _describe(emitter, self._center) for emitter in self._emitters]
            faces, normals = np.asarray(mesh.faces), np.asarray(mesh.vertex_normals)
            moved = vertices - self._center
            np.savez(self._folder / "geometry.npz", vertices=moved, faces=faces, normals=normals)
            job = json.dumps({"lights": described})
            (self._folder / "job.json").write_text(job, encoding="utf-8")
            self._log = stack.enter_context((self._folder / "log.txt").open("w+", encoding="utf-8"))
            self._process = stack.enter_context(_process(python, self._folder, self._log))
            self._wait()
            self._stack = stack.pop_all()

    def __enter__(self) -> "BlenderRenderer":
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def render(self, camera: Camera) -> Rendering:
        """Render the view of a camera."""
        pictures = [
            picture
            for place, emitter in enumerate(self._emitters)
            if emitter is not None
            for picture in self._pictures(place, emitter)
        ]
        if not pictures:
            pictures = [self._picture(None, "dark", shadows=False, soft=False)]
        pose = np.array(camera.pose)
        pose[:3, 3] -= self._center
        lens = dataclasses.asdict(camera.intrinsics) | {"pose": pose.tolist()}
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # `_wait` reports why it ended
            self._process.stdin.write(json.dumps({"camera": lens, "pictures": pictures}) + "\n")
            self._process.stdin.flush()
        self._wait()
        return self._collect(pictures, camera.intrinsics.shape)

    def _pictures(self, place: int, emitter: Emitter) -> list[dict[str, Any]]:
        """Pictures to render for a light: without shadows, and with."""
        soft = emitter.kind in ("rect", "sky")
        pictures = [self._picture(place, "open", shadows=False, soft=soft)]
        if self._shadows:
            extent = emitter.extent > 0
            if extent:  # compared with rays to the same points of the lamp, unshadowed surface keeps exactly 1
                pictures.append(self._picture(place, "open-soft", shadows=False, soft=True))
            pictures.append(self._picture(place, "shadowed", shadows=True, soft=soft or extent))
        return pictures

    def _picture(self, place: int | None, name: str, *, shadows: bool, soft: bool) -> dict[str, Any]:
        file = str(self._folder / f"{place}-{name}.exr")
        samples = self._samples if soft else 1
        return {"file": file, "light": place, "samples": samples, "shadows": shadows, "soft": soft}

    def _collect(self, pictures: list[dict[str, Any]], shape: tuple[int, int]) -> Rendering:
        # Channels are red, green, blue (all alike), alpha and depth.
        layers = {Path(picture["file"]).stem: read_image(Path(picture["file"])) for picture in pictures}
        *_, alpha, depth = np.moveaxis(next(iter(layers.values())), -1, 0)
        hit = alpha > 0.5
        shading = np.zeros((*shape, len(self._lights)), np.float32)
        visibility = np.ones_like(shading)
        for k, light in enumerate(self._lights):
            if light.UNIFORM:
                shading[..., k] = np.where(hit, light.illuminance_at(jnp.zeros(3), jnp.array([0.0, 0.0, 1.0])), 0.0)
                continue
            shading[..., k] = np.where(hit, math.pi * layers[f"{k}-open"][..., 0], 0.0)
            if self._shadows:
                unshadowed = layers.get(f"{k}-open-soft", layers[f"{k}-open"])[..., 0]
                lit = layers[f"{k}-shadowed"][..., 0] / np.where(unshadowed > 0, unshadowed, 1.0)
                visibility[..., k] = np.where(hit & (unshadowed > 0), np.clip(lit, 0.0, 1.0), 1.0)
        return Rendering(shading, visibility, np.where(hit, depth, 0.0), hit)

    def _wait(self) -> None:
        """Wait for Blender's answer, and skip its other output."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith(ANSWER):
                return
        self._log.seek(0)
        last = next((line.strip() for line in reversed(self._log.readlines()) if line.strip()), "no message")
        raise InputError(f"blender: ended with status {self._process.wait()} ({last})")


def blender_python() -> str:
    """Path of the Python that runs Blender: `$HYJAX_BLENDER` if set, else this one if it has bpy."""
    named = os.environ.get("HYJAX_BLENDER")
    if named:
        if not os.access(named, os.X_OK) or Path(named).is_dir():
            raise InputError(f"HYJAX_BLENDER: {named} is not a program; point it at a python that has bpy")
        return named
    if importlib.util.find_spec("bpy") is not None:
        return sys.executable
    raise InputError(
        "blender: no bpy here; pip install bpy on Python 3.13, or install bpy in an environment of "
        "its own (bpy 5.0 needs Python 3.11, later ones 3.13) and set HYJAX_BLENDER to its python"
    )


@contextlib.contextmanager
def _process(python: str, folder: Path, log: Any) -> Any:
    """Run Blender until the block ends. With -P nothing is imported from the worker's folder."""
    command = [python, "-P", str(WORKER), str(folder)]
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=log,
        text=True,
        start_new_session=True,  # Ctrl-C is ours to handle
    )
    try:
        yield process
    finally:
        process.kill()  # it keeps nothing that it would have to put away
        process.wait()
        for stream in (process.stdin, process.stdout):
            assert stream is not None
            with contextlib.suppress(BrokenPipeError):
                stream.close()


def _describe(emitter: Emitter, center: Float[np.ndarray, "3"]) -> Any:
    """Light in Blender's plain numbers, with places relative to `center`."""
    entry = {key: value for key, value in vars(emitter).items() if value is not None}
    if emitter.position is not None:
        entry["position"] = emitter.position - center
    if emitter.kind == "spot":
        # Blender's spot is a masked point of the same flux; ours sends all of its flux down the cone.
        share = 0.5 * (1.0 - 0.5 * (math.cos(emitter.inner_angle) + math.cos(emitter.outer_angle)))
        entry["strength"] = emitter.strength / share
    if emitter.aperture is not None:
        aperture = {key: np.asarray(value, np.float64) for key, value in vars(emitter.aperture).items()}
        entry["aperture"] = aperture | {"center": aperture["center"] - center}
    return jax.tree.map(lambda value: value.tolist() if isinstance(value, np.ndarray) else value, entry)
