"""Engine that runs a program on a graphics processor from Python, through wgpu. `page/engine.js` is its twin."""

import dataclasses
import os
import tempfile
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from hyjax.device.program import Buffer, Launch, Program, grid_of
from hyjax.util.errors import InputError
from hyjax.util.extras import optional_module

TIMESTAMP_FEATURE = "timestamp-query"


def open_device(precision: str = "f32") -> Any:
    """Open a wgpu device of the best adapter."""
    os.environ.setdefault("WGPU_FORCE_OFFSCREEN", "1")
    os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.gettempdir())  # else drivers complain on stderr
    wgpu = optional_module("wgpu", "device", "webgpu")
    try:
        adapter = wgpu.gpu.request_adapter_sync(power_preference="high-performance")
    except RuntimeError as error:
        raise InputError(f"webgpu: no graphics driver was found ({str(error).splitlines()[0]})") from None
    wanted = [name for name in (TIMESTAMP_FEATURE, "shader-f16") if name in adapter.features]
    if precision == "f16" and "shader-f16" not in wanted:
        raise InputError(f"webgpu: {adapter.info['device']} has no half precision; leave it out")
    names = ("max-storage-buffer-binding-size", "max-buffer-size", "max-storage-buffers-per-shader-stage")
    limits = {name: adapter.limits[name] for name in names}
    return adapter.request_device_sync(required_features=wanted, required_limits=limits)


def describe(device: Any) -> str:
    """Name of a device's adapter."""
    return str(device.adapter.info["device"])


@dataclasses.dataclass
class ShaderEngine:
    """Engine of a program: its buffers and pipelines.

    Args:
        sizes: bytes of buffers that the program leaves open.
    """

    program: Program
    lights: int
    sizes: Mapping[str, int]
    device: Any

    def __post_init__(self) -> None:
        import wgpu

        self._wgpu = wgpu
        sizes = {
            name: buffer.bytes * buffer.groups.count(self.lights) for name, buffer in self.program.buffers.items()
        }
        self._buffers = {
            name: self._make(name, size, self.program.buffers.get(name))
            for name, size in (sizes | dict(self.sizes)).items()
        }
        height, width = self.program.size
        usage = wgpu.TextureUsage
        textures = {
            "shown": ("r32uint", usage.RENDER_ATTACHMENT | usage.TEXTURE_BINDING),
            "photo": ("rgba8unorm", usage.COPY_DST | usage.TEXTURE_BINDING),
            "depth": ("depth32float", usage.RENDER_ATTACHMENT),
        }
        self._textures = {
            name: self.device.create_texture(size=(width, height, 1), format=kind, usage=flags)
            for name, (kind, flags) in textures.items()
        }
        self._pipelines: dict[str, Any] = {}
        self._bound: dict[Launch, Any] = {}

    def _make(self, name: str, size: int, buffer: Buffer | None) -> Any:
        usage, uniform = self._wgpu.BufferUsage, buffer is not None and buffer.uniform
        flags = usage.COPY_DST | usage.COPY_SRC | usage.STORAGE | (usage.UNIFORM if uniform else 0)
        most = min(self.device.limits[key] for key in ("max-storage-buffer-binding-size", "max-buffer-size"))
        if size > most:
            raise InputError(
                f"webgpu: {name!r} needs {size >> 20} MiB, the device takes {most >> 20}; choose a smaller --size"
            )
        made = self.device.create_buffer(size=max(16, -(-size // 16) * 16), usage=flags, label=name)
        if buffer is not None and buffer.initial:
            self.device.queue.write_buffer(made, 0, np.asarray(buffer.initial, np.uint32).tobytes())
        return made

    def upload(self, name: str, values: np.ndarray) -> None:
        """Write to a buffer from its beginning."""
        if values.size:
            self.device.queue.write_buffer(self._buffers[name], 0, np.ascontiguousarray(values).tobytes())

    def download(self, name: str, dtype: Any = np.float32) -> np.ndarray:
        """Content of a buffer."""
        return np.frombuffer(self.device.queue.read_buffer(self._buffers[name]), dtype)

    def run(self, *stages: str, jobs: int = 0, side: int = 0) -> None:
        """Run the launches of stages, one stage after the other.

        Args:
            side: texels a side of each of them, with the gutter.
        """
        encoder = self.device.create_command_encoder()
        for stage in stages:
            self._encode(encoder, (launch for launch in self.program.launches if launch.stage == stage), jobs, side)
        self.device.queue.submit([encoder.finish()])

    def _encode(self, encoder: Any, launches: Iterable[Launch], jobs: int, side: int) -> None:
        for launch in launches:
            if launch.shader.startswith("raster-"):
                self._encode_raster(encoder, launch)
                continue
            depth = jobs if launch.jobs else launch.depth.count(self.lights)
            if depth == 0:
                continue
            width, height = grid_of((side, side)) if launch.jobs else (launch.width, launch.height)
            render = encoder.begin_compute_pass()
            render.set_pipeline(self._pipeline(launch.shader))
            render.set_bind_group(0, self._bind(launch))
            render.dispatch_workgroups(width, height, depth)
            render.end()

    def _encode_raster(self, encoder: Any, launch: Launch) -> None:
        views = {name: self._textures[name].create_view() for name in ("shown", "depth")}
        color = {"view": views["shown"], "load_op": "clear", "store_op": "store", "clear_value": (0, 0, 0, 0)}
        depth = {
            "view": views["depth"],
            "depth_load_op": "clear",
            "depth_store_op": "store",
            "depth_clear_value": 0.0,
        }
        render = encoder.begin_render_pass(color_attachments=[color], depth_stencil_attachment=depth)
        render.set_pipeline(self._pipeline(launch.shader))
        render.set_bind_group(0, self._bind(launch))
        render.draw(launch.width)
        render.end()

    def _pipeline(self, shader: str) -> Any:
        if shader not in self._pipelines:
            module = self.device.create_shader_module(code=self.program.shaders[shader], label=shader)
            if shader.startswith("raster-"):
                self._pipelines[shader] = self.device.create_render_pipeline(
                    layout="auto",
                    vertex={"module": module, "entry_point": "vertex"},
                    fragment={"module": module, "entry_point": "fragment", "targets": [{"format": "r32uint"}]},
                    primitive={"topology": "triangle-list", "cull_mode": "none"},
                    depth_stencil={
                        "format": "depth32float",
                        "depth_write_enabled": True,
                        "depth_compare": "greater",
                    },
                )
            else:
                self._pipelines[shader] = self.device.create_compute_pipeline(
                    layout="auto", compute={"module": module, "entry_point": "main"}
                )
        return self._pipelines[shader]

    def _bind(self, launch: Launch) -> Any:
        if launch not in self._bound:
            entries = []
            for number, name in enumerate(launch.bind):
                if name in self._textures:
                    resource = self._textures[name].create_view()
                else:
                    resource = {"buffer": self._buffers[name], "offset": 0, "size": self._buffers[name].size}
                entries.append({"binding": number, "resource": resource})
            layout = self._pipeline(launch.shader).get_bind_group_layout(0)
            self._bound[launch] = self.device.create_bind_group(layout=layout, entries=entries)
        return self._bound[launch]
