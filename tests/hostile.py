"""Calls of public functions with each argument in turn exchanged for nonsense: what is raw is counted.

    python -m tests.hostile            # a line for each raw answer, and their number

An answer is raw if it is neither a result, nor an `InputError`, nor a `TypeError` that names the argument.
"""

import contextlib
import dataclasses
import functools
import io
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import hyjax
from hyjax import metrics, video

H, W = 12, 16
RNG = np.random.default_rng(0)
PICTURE = jnp.asarray(RNG.random((H, W, 3)), jnp.float32)
MASK = jnp.ones((H, W), bool)
EDGES = (jnp.ones((H - 1, W)), jnp.ones((H, W - 1)))
CELLS = jnp.asarray(RNG.random((H // 2, W // 2, 3)), jnp.float32)
SCHEDULE = hyjax.Schedule.uniform([(4, 1), (2, 1)])
LIGHT = hyjax.PointLight(jnp.array([0.5, 0.5, 2.0]), jnp.asarray(800.0), jnp.ones(3))
GBUFFER = hyjax.GBuffer(PICTURE, jnp.zeros((H, W, 3)).at[..., 2].set(1.0), jnp.ones((H, W)), MASK)
CAMERA = {"pose": jnp.eye(4), "intrinsics": jnp.array([[10.0, 0.0, 8.0], [0.0, 10.0, 6.0], [0.0, 0.0, 1.0]])}
VIEW = hyjax.View.of(PICTURE, GBUFFER, **CAMERA)
SHADED = hyjax.Shaded.of([LIGHT], PICTURE[..., :1], PICTURE[..., :1], MASK)
MEMORY = video.Memory(PICTURE[..., :2], jnp.ones((H, W)), *CAMERA.values(), (LIGHT,))

Call = tuple[Callable[..., Any], dict[str, Any]]
CALLS: dict[str, Call] = {
    "conductance": (hyjax.conductance, {"guide": PICTURE, "kappa": 0.1}),
    "diffuse": (hyjax.diffuse, {"y": PICTURE, "edges": EDGES, "step_sizes": jnp.full(2, 0.2), "source": PICTURE}),
    "diffuse_step": (hyjax.diffuse_step, {"y": PICTURE, "edges": EDGES, "lam": 0.2}),
    "downsample": (hyjax.downsample, {"y": PICTURE, "factor": 2}),
    "upsample": (hyjax.upsample, {"y": CELLS, "factor": 2, "shape": (H, W)}),
    "min_pool": (hyjax.min_pool, {"edges": EDGES, "factor": 2}),
    "cascade": (hyjax.cascade, {"y": PICTURE, "guide": PICTURE, "schedule": SCHEDULE}),
    "level_edges": (hyjax.level_edges, {"guide": PICTURE, "schedule": SCHEDULE}),
    "cascade_known": (
        hyjax.cascade_known,
        {"y": PICTURE, "confidence": MASK[..., None], "guide": PICTURE, "schedule": SCHEDULE},
    ),
    "shadow_pass": (hyjax.shadow_pass, {"raw": PICTURE, "guide": PICTURE, "schedule": SCHEDULE}),
    "fill_visibility": (hyjax.fill_visibility, {"raw": PICTURE, "known": PICTURE > 0.5, "guide": PICTURE}),
    "solve": (hyjax.solve, {"source": PICTURE, "edges": EDGES, "fidelity": 1.0, "start": PICTURE}),
    "super_resolve": (
        hyjax.super_resolve,
        {"source": CELLS, "known": MASK[::2, ::2], "guide": PICTURE, "schedule": SCHEDULE, "factor": 2},
    ),
    "guided_upsample": (hyjax.guided_upsample, {"y": CELLS, "factor": 2, "guide": PICTURE, "kappa": 0.1}),
    "step_cycle": (hyjax.step_cycle, {"n": 4, "time": 1.5}),
    "uniform": (hyjax.Schedule.uniform, {"steps": [(2, 1)], "kappa": 0.1, "lam": 0.2, "norm": "l2"}),
    "blackbody": (hyjax.blackbody, {"kelvin": 3000.0}),
    "luminance": (hyjax.luminance, {"linear": PICTURE}),
    "to_linear": (hyjax.to_linear, {"display": PICTURE}),
    "to_display": (hyjax.to_display, {"linear": PICTURE}),
    "composite": (hyjax.composite, {"relight_filter": PICTURE, "frame": PICTURE}),
    "shade": (hyjax.shade, {"gbuffer": GBUFFER, "lights": [LIGHT]}),
    "shade_each": (hyjax.shade_each, {"gbuffer": GBUFFER, "lights": [LIGHT]}),
    "colored": (hyjax.colored, {"each": PICTURE[..., :1], "lights": [LIGHT]}),
    "visibility": (hyjax.visibility, {"gbuffer": GBUFFER, "light": LIGHT, "shadow_map": None}),
    "visibilities": (hyjax.visibilities, {"gbuffer": GBUFFER, "lights": [LIGHT], "shadow_maps": [None]}),
    "View.of": (hyjax.View.of, {"display": PICTURE, "gbuffer": GBUFFER}),
    "View.shade": (VIEW.shade, {"lights": [LIGHT], "interleave": 1}),
    "Shaded.of": (
        hyjax.Shaded.of,
        {"setup": [LIGHT], "illuminance": PICTURE[..., :1], "visibility": PICTURE[..., :1], "hit": MASK},
    ),
    "relight": (
        hyjax.relight,
        {"view": VIEW, "shaded": SHADED, "guide": PICTURE, "schedule": SCHEDULE, "shadow_schedule": SCHEDULE},
    ),
    "psnr": (metrics.psnr, {"image": PICTURE, "reference": PICTURE, "valid": MASK}),
    "ssim": (metrics.ssim, {"image": PICTURE, "reference": PICTURE, "valid": MASK}),
    "filter_loss": (
        metrics.losses.filter_loss,
        {"relight_filter": PICTURE, "target": PICTURE, "frame": PICTURE, "valid": MASK},
    ),
    "charbonnier": (metrics.losses.charbonnier, {"x": PICTURE, "epsilon": 0.1}),
    "fill_depth": (video.fill_depth, {"gbuffer": GBUFFER, "guide": PICTURE, "schedule": SCHEDULE}),
    "recall": (video.recall, {"memory": MEMORY, "depth": jnp.ones((H, W)), **CAMERA}),
    "steady": (
        video.steady,
        {"channels": PICTURE[..., :2], "depth": jnp.ones((H, W)), **CAMERA, "memory": MEMORY, "keep": 0.5},
    ),
    "tune": (hyjax.tune, {"settings": None, "fps": 60.0, "budget_ms": None}),
    "tune_schedule": (hyjax.tune_schedule, {"settings": None, "fps": 60.0, "budget_ms": None}),
}

NONSENSE: dict[str, Any] = {
    "text": "abc",
    "number": -1.5,
    "huge": 1e300,
    "huge_int": 10**400,
    "nan": float("nan"),
    "complex": 1j,
    "bool": True,
    "mapping": {"a": 1},
    "ragged": [[1.0, 2.0], [3.0]],
    "words": ["a", "b"],
    "object": object(),
    "class": int,
    "empty": np.zeros((0, 0, 3), np.float32),
    "int_array": np.ones((H, W, 3), np.int32),
    "complex_array": np.ones((H, W, 3), np.complex64),
    "no_channels": np.ones((H, W), np.float32),
    "many_axes": np.ones((2, H, W, 3), np.float32),
    "other_size": np.ones((H + 1, W, 3), np.float32),
    "texts": np.array([["a"]]),
    "key": jax.random.key(0),
}
DEFAULTS = {"source", "start", "shadow_schedule", "valid", "settings"}
"""Arguments that None stands for a default of."""
MAY_MAKE_SENSE = {"number", "nan", "empty", "no_channels", "many_axes", "other_size", "bool", "None", "text"}
"""Of some argument or other: all else is refused wherever it is given."""


def more_calls(folder: Path) -> dict[str, Call]:
    """Of what reads, writes and holds a scene; those of `CALLS` are arrays in and out."""
    import trimesh
    from reference.listed_frames import ListedFrames

    from hyjax.configuration import Configuration
    from hyjax.data.capture import Frame
    from hyjax.data.light_file import parse_lights, read_lights, write_lights
    from hyjax.data.registry import open_capture
    from hyjax.export.graph import cascade_graph, example_inputs, guide_graph
    from hyjax.geometry.camera import Camera, Intrinsics, check_pose, look_at
    from hyjax.geometry.depth_sensor import PHONE_LIDAR
    from hyjax.geometry.point_cloud import disc_mesh
    from hyjax.geometry.raycast import RayCaster
    from hyjax.guide.choose import open_guide
    from hyjax.guide.weights import load_network, load_weights, save_guide
    from hyjax.light.kinds import Aperture, RectLight
    from hyjax.light.setup import LightSetup
    from hyjax.live.messages import write_live_frame
    from hyjax.pairs.registry import open_pairs
    from hyjax.photo_light.sources import PhotoWindow
    from hyjax.scene.relighter import Relighter
    from hyjax.scene.scene import Scene
    from hyjax.training.run import train
    from hyjax.video import CarriedGuide

    lens = Intrinsics(W, H, 12.0, 12.0, W / 2, H / 2)
    up, box = np.array([0.0, 0.0, 1.0]), trimesh.creation.box((4.0, 4.0, 3.0))
    camera = Camera(lens, look_at(np.array([0.1, 0.0, 0.0]), np.array([2.0, 0.1, 0.0]), up))
    frame = Frame("0", np.asarray(PICTURE), camera, 0.0, np.ones((H, W), np.float32))

    weights = Path(hyjax.__file__).parent / "guide/trained/small.safetensors"
    capture, (network, _) = ListedFrames([frame], up, PHONE_LIDAR), load_network(weights)
    scene = Scene(capture, box, slack=None)
    kept = Configuration.preset("fast").with_choices({"photo_light": "kept"})
    relighter = Relighter(scene, [LIGHT], kept)
    caster = RayCaster(box)
    guide, lights_file = open_guide("rgb"), folder / "lights.json"
    write_lights(lights_file, LightSetup((LIGHT,)))
    origins, directions = np.zeros((2, 3)), np.tile(up, (2, 1))
    points = RNG.random((40, 3))
    entry = {"lights": [{"kind": "point", "position": [0, 0, 1], "luminous_flux": 800}]}
    return {
        "Intrinsics": (Intrinsics, dataclasses.asdict(lens)),
        "Intrinsics.crop": (lens.crop, {"top": 0, "left": 0, "height": 4, "width": 4}),
        "Intrinsics.resize": (lens.resize, {"height": 4, "width": 4}),
        "Intrinsics.turned": (lens.turned, {"quarters": 1}),
        "Camera": (Camera, {"intrinsics": lens, "pose": camera.pose}),
        "Camera.project": (camera.project, {"points": points}),
        "Camera.unproject": (camera.unproject, {"depth": np.ones((H, W))}),
        "Camera.turned": (camera.turned, {"quarters": 1}),
        "check_pose": (check_pose, {"pose": camera.pose, "where": "pose"}),
        "look_at": (look_at, {"eye": np.zeros(3), "target": np.ones(3), "up": up}),
        "Frame": (Frame, {"name": "0", "image": np.asarray(PICTURE), "camera": camera, "time": 0.0}),
        "RayCaster": (RayCaster, {"mesh": box}),
        "RayCaster.cast": (caster.cast, {"origins": origins, "directions": directions}),
        "RayCaster.occluded": (
            caster.occluded,
            {"origins": origins, "directions": directions, "max_distance": np.ones(2)},
        ),
        "RayCaster.gbuffer": (caster.gbuffer, {"camera": camera}),
        "RayCaster.gbuffer_by_rays": (caster.gbuffer_by_rays, {"camera": camera}),
        "disc_mesh": (disc_mesh, {"points": points, "voxel": 0.01, "progress": False}),
        "open_capture": (
            open_capture,
            {"path": folder / "none", "progress": False, "scale": None, "strict": False},
        ),
        "read_lights": (read_lights, {"path": lights_file, "up": up}),
        "parse_lights": (parse_lights, {"content": entry, "up": up}),
        "write_lights": (write_lights, {"path": folder / "b.json", "setup": LightSetup((LIGHT,))}),
        "Scene": (Scene, {"capture": capture, "mesh": box, "size": (H, W), "photo_sources": None}),
        "Scene.open": (Scene.open, {"settings": hyjax.SceneSettings(capture=folder / "none")}),
        "Scene.frame": (scene.frame, {"index": 0}),
        "Scene.view": (scene.view, {"index": 0}),
        "Scene.gbuffer": (scene.gbuffer, {"camera": camera}),
        "Scene.lights": (scene.lights, {"lights": [LIGHT]}),
        "Scene.shade": (
            scene.shade,
            {"view": scene.view(0), "lights": [LIGHT], "shadows": False, "keep_photo_light": True},
        ),
        "Scene.shadow_maps": (scene.shadow_maps, {"lights": [LIGHT], "occluders": "surface", "scale": 0.05}),
        "Scene.relit": (scene.relit, {"frame": 0, "lights": [LIGHT], "configuration": kept}),
        "Relighter": (
            Relighter,
            {"place": scene, "lights": [LIGHT], "configuration": kept, "guide": guide, "shadows": False},
        ),
        "Relighter.relit": (relighter.relit, {"frame": 0}),
        "Relighter.picture": (relighter.picture, {"frame": 0}),
        "Relighter.view": (relighter.view, {"frame": 0}),
        "Relighter.shade": (relighter.shade, {"view": relighter.view(0)}),
        "Relighter.lit": (relighter.lit, {"frame": 0}),
        "relight_capture": (hyjax.relight_capture, {"settings": hyjax.RelightSettings(lights="none")}),
        "Configuration.of": (Configuration.of, {"configuration": "fast"}),
        "Configuration.open": (Configuration.open, {"text": "fast"}),
        "Configuration.preset": (Configuration.preset, {"name": "fast"}),
        "Configuration.from_json": (Configuration.from_json, {"text": Configuration().to_json()}),
        "Configuration.with_choices": (kept.with_choices, {"values": {"photo_light": "kept"}}),
        "Configuration.value": (kept.value, {"name": "photo_light"}),
        "Configuration": (Configuration, {"name": "x", "schedule": SCHEDULE, "mode": "paper", "scale": 1}),
        "Schedule": (hyjax.Schedule, {"levels": SCHEDULE.levels, "pooling": "min", "norm": "l2", "name": ""}),
        "Schedule.of": (hyjax.Schedule.of, {"schedule": SCHEDULE}),
        "Schedule.preset": (hyjax.Schedule.preset, {"name": "hyjax", "kappa": 0.1, "lam": 0.2}),
        "Schedule.from_json": (hyjax.Schedule.from_json, {"text": SCHEDULE.to_json()}),
        "LightSetup.of": (LightSetup.of, {"lights": [LIGHT]}),
        "Aperture.facing": (
            Aperture.facing,
            {"center": np.zeros(3), "normal": np.ones(3), "up": up, "width": 1.0, "height": 1.0},
        ),
        "RectLight.filling": (
            RectLight.filling,
            {
                "opening": Aperture.facing(np.zeros(3), np.array([1.0, 0, 0]), up, 1.0, 1.0),
                "luminous_flux": 800.0,
                "color": np.ones(3),
            },
        ),
        "PhotoWindow.facing": (
            PhotoWindow.facing,
            {
                "name": "w",
                "center": np.zeros(3),
                "normal": np.array([1.0, 0, 0]),
                "up": up,
                "width": 1.0,
                "height": 1.0,
            },
        ),
        "Video": (video.Video, {"keep": 0.5}),
        "CarriedGuide": (CarriedGuide, {"every": 2}),
        "write_png": (hyjax.write_png, {"path": folder / "a.png", "display": np.asarray(PICTURE)}),
        "open_guide": (open_guide, {"name": "rgb"}),
        "RgbGuide.features": (guide.features, {"display": PICTURE}),
        "save_guide": (
            save_guide,
            {"path": folder / "a.safetensors", "network": network, "kappa": 1.0, "dtype": "float32"},
        ),
        "load_network": (load_network, {"path": weights, "encoder": None}),
        "load_weights": (load_weights, {"path": weights, "network": network}),
        "train": (train, {"settings": None, "out": folder / "run"}),
        "open_pairs": (open_pairs, {"text": "folder:none"}),
        "squared_error_map": (metrics.squared_error_map, {"image": PICTURE, "reference": PICTURE}),
        "ssim_map": (metrics.ssim_map, {"image": PICTURE, "reference": PICTURE}),
        "load_lpips": (metrics.load_lpips, {"path": folder / "none", "net": "alex"}),
        "display_loss": (
            metrics.losses.display_loss,
            {"picture": PICTURE, "target_picture": PICTURE, "valid": MASK},
        ),
        "example_inputs": (example_inputs, {"shape": (H, W), "channels": 3}),
        "cascade_graph": (cascade_graph, {"schedule": SCHEDULE, "guide": guide, "shape": (H, W), "channels": 3}),
        "guide_graph": (guide_graph, {"guide": guide, "shape": (H, W)}),
        "write_live_frame": (functools.partial(write_live_frame, io.BytesIO()), {"frame": frame}),
    }


def nonsense(name: str, argument: str, usual: Any) -> Iterator[tuple[str, Any]]:
    """(kind, value) of what is given in an argument's place; none that a command would work at for minutes."""
    for kind, value in {"None": None, **NONSENSE}.items():
        if kind == "None" and (usual is None or argument in DEFAULTS):
            continue
        if name.startswith("tune") and kind in MAY_MAKE_SENSE - {"text"} and argument == "budget_ms":
            continue
        yield kind, value


def raw_answers(name: str, call: Call) -> Iterator[tuple[str, str, Exception | None]]:
    """(argument, nonsense, error if it is raw) of all calls of one function."""
    function, given = call
    for argument in given:
        for kind, value in nonsense(name, argument, given[argument]):
            try:
                function(**given | {argument: value})
            except hyjax.InputError:
                yield argument, kind, None
            except Exception as error:
                named = isinstance(error, TypeError) and re.search(rf"\b{argument}\b", str(error))
                yield argument, kind, None if named else error
            else:
                yield argument, kind, None


def main() -> int:
    """Count the raw answers."""
    sys.path.append(str(Path(__file__).parent))  # where helpers of other tests are
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):  # a text may be taken for a path
        calls, count, raw = CALLS | more_calls(Path(folder)), 0, 0
        for name in sys.argv[1:] or calls:
            for argument, kind, error in raw_answers(name, calls[name]):
                count += 1
                if error is not None:
                    raw += 1
                    print(f"{name}({argument}={kind}): {type(error).__name__}: {str(error)[:100]!r}", flush=True)
    print(f"{raw} of {count} answers are raw")
    return 1 if raw else 0


if __name__ == "__main__":
    raise SystemExit(main())
