"""Seeds of the fuzzer: small files of every kind, made by the project's own writers. Captures are in `captures`."""

import base64
import io
import json
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image
from safetensors.numpy import save_file

from hyjax.geometry.mesh import save_mesh
from hyjax.util.images import write_depth, write_exr, write_labels, write_png

PIXELS = np.linspace(0.0, 1.0, 12 * 16 * 3, dtype=np.float32).reshape(12, 16, 3)
UP = np.array([0.0, 0.0, 1.0])


def pngs(folder: Path) -> None:
    write_png(folder / "a.png", PIXELS)
    write_png(folder / "b.png", PIXELS[..., :1])
    write_depth(folder / "c.png", 3 * PIXELS[..., 0])
    Image.fromarray(np.uint8(255 * PIXELS)).convert("P").save(folder / "d.png")


def jpegs(folder: Path) -> None:
    picture = Image.fromarray(np.uint8(255 * PIXELS))
    picture.save(folder / "a.jpg", quality=90)
    picture.save(folder / "b.jpg", progressive=True)


def exrs(folder: Path) -> None:
    write_exr(folder / "a.exr", 4 * PIXELS)
    write_exr(folder / "b.exr", PIXELS[..., :1])


def pnms(folder: Path) -> None:
    picture = Image.fromarray(np.uint8(255 * PIXELS))
    picture.save(folder / "a.ppm")
    picture.convert("L").save(folder / "b.pgm")
    (folder / "c.ppm").write_text("P3\n# a comment\n2 1 255\n0 1 2 3 4 5\n")


def tiffs(folder: Path) -> None:
    picture = Image.fromarray(np.uint8(255 * PIXELS))
    picture.save(folder / "a.tif")
    picture.save(folder / "b.tif", compression="tiff_lzw")
    Image.fromarray(PIXELS[..., 0]).save(folder / "c.tif", compression="tiff_adobe_deflate")


def webps(folder: Path) -> None:
    picture = Image.fromarray(np.uint8(255 * PIXELS))
    picture.save(folder / "a.webp")
    picture.save(folder / "b.webp", lossless=True)


def bmps(folder: Path) -> None:
    picture = Image.fromarray(np.uint8(255 * PIXELS))
    picture.save(folder / "a.bmp")
    picture.convert("P").save(folder / "b.bmp")


def depths(folder: Path) -> None:
    write_depth(folder / "a.png", 3 * PIXELS[..., 0])


def labels(folder: Path) -> None:
    write_labels(folder / "a.png", np.uint8(2 * PIXELS[..., 0]))


def pictures(folder: Path) -> None:
    for make in (pngs, jpegs, exrs, pnms, tiffs, webps, bmps):
        make(folder)


# ---- texts ----


def schedules(folder: Path) -> None:
    from hyjax.core.schedule import Schedule

    for name in ("paper-50", "hyjax"):
        (folder / f"{name}.json").write_text(Schedule.preset(name).to_json())


def configurations(folder: Path) -> None:
    from hyjax.configuration import Configuration

    for name in ("balanced", "fast"):
        (folder / f"{name}.json").write_text(Configuration.preset(name).to_json())


def device_latencies(folder: Path) -> None:
    from hyjax.core.schedule import guided_schedule
    from hyjax.tuning.device_latency import (
        Device,
        DeviceLatency,
        DeviceWorkload,
        Stage,
        Timed,
        WarmUp,
        write_latency,
    )

    measured = tuple(
        Timed.of(guided_schedule([(factor, 2), (1, 1)]), milliseconds=(1.0, 1.5) * 6) for factor in (2, 4)
    )
    latency = DeviceLatency(
        format=1,
        device=Device(name="Phone", adapter="adapter", agent="engine 1", timer="gpu"),
        workload=DeviceWorkload(height=64, width=64, lights=2),
        measured=measured,
        warm_up=WarmUp(seconds=3.0, runs=40),
        rounds=tuple(map(float, range(12))),
        stages={"guide": Stage(median=1.0, p95=2.0)},
    )
    write_latency(folder / "a.json", latency)


def tour_plans(folder: Path) -> None:
    from hyjax.tour.plan import Lamp, TourPlan, Window

    plan = TourPlan(
        windows=(Window((2.0, 0.0, 1.5), (-1.0, 0.0, 0.0), 1.0, 2.0),), lamps=(Lamp("bulb", (0.0, 0.0, 1.0)),)
    )
    (folder / "a.json").write_text(plan.to_json())


def lights(folder: Path) -> None:
    from hyjax.data.light_file import read_lights, write_lights

    (folder / "a.yaml").write_text(LIGHTS)
    write_lights(folder / "b.json", read_lights(folder / "a.yaml", UP))


LIGHTS = """reference_lux: 200
existing: {window_0: 0.5}
lights:
  - {kind: point, position: [0, 1.0, 2], luminous_flux: 800, temperature: 2700}
  - kind: spot
    position: [1, 1, 2.0]
    direction: [0, 0, -1]
    luminous_flux: 600
    inner_degrees: 20
    outer_degrees: 35
  - {kind: ambient, illuminance: 20, color: [1, 0.9, 0.8]}
"""


def photo_sources(folder: Path) -> None:
    (folder / "a.yaml").write_text(
        "windows:\n  - {center: [2.0, 0.0, 1.5], normal: [-1, 0, 0], width: 1.2, height: 1.4, name: west}\n"
        "lamps:\n  - {position: [0.5, 0.2, 1.1], radius: 0.1}\n"
    )


def sweep_specs(folder: Path) -> None:
    what = "scenes: ['room:builtin-0']\nlights: [evening-lamps]\n"
    names = "configurations: [balanced, paper]\nframes: 2\nsize: 64x48\nseeds: [0, 1]\n"
    (folder / "a.yaml").write_text(what + names)
    draws = "configurations: {space: default, count: 3, seed: 1}\nframes: [0, 2]\n"
    (folder / "b.yaml").write_text(what + draws)


def sweep_rows(folder: Path) -> None:
    from hyjax.sweep.rows import DRIVER_FILE

    rows = [{"key": f"{k}", "kind": kind, "loss": 0.1 * k, "task": {"a": [k]}} for k, kind in enumerate("ab")]
    text = "".join(json.dumps(row) + "\n" for row in [*rows, rows[0] | {"kind": "error"}])
    (folder / "rows-host-1-0.jsonl").write_text(text)
    (folder / DRIVER_FILE).write_text("host-1-abc")


def run_logs(folder: Path) -> None:
    (folder / "a.jsonl").write_text("".join(f'{{"k": {k}, "values": [{k}, 0.5], "name": "x"}}\n' for k in range(4)))


def training_run(folder: Path) -> None:
    from hyjax.training.log import TrainingLog
    from hyjax.training.settings import TrainSettings

    log = TrainingLog(folder, TrainSettings(iterations=10), resume=False)
    log.open(0, {"device": "cpu"})
    log.add(iteration=1, loss=0.5)
    log.add(iteration=2, loss=0.4, validation={"loss": 0.3})


def study(folder: Path) -> None:
    from hyjax.tuning.space import Space
    from hyjax.tuning.study import Study
    from hyjax.tuning.trial import Trial

    kept, space = Study(folder, "frame", {"seed": 0}), Space.of(truth=True)
    kept.add(space, Trial({space.parameters[0].name: space.parameters[0].values[0]}, "default", (0.1,), 0.5))
    kept.remember("refined", lambda: {"kappa": 3})


def rows_of_results(folder: Path) -> None:
    row = {"experiment": "a", "settings": {"seed": 0}, "seed": 0, "device": "cpu", "versions": {"jax": "0"}}
    lines = [row | {"loss": 0.5}, row | {"kind": "finished"}]
    (folder / "rows.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))


def web_page(folder: Path) -> None:
    (folder / "page.json").write_text(json.dumps({"made_by": "hyjax", "frames": [{"file": "frames/a.jpg"}]}))


# ---- weights, arrays, meshes ----


def safetensors(folder: Path) -> None:
    arrays = {f"encoder.model.{k}.weight": np.ones((2, 3, 1, 1), np.float32) for k in range(3)}
    save_file(arrays, folder / "a.safetensors", metadata={"encoder": "conv-small"})


def arrays(folder: Path) -> None:
    np.savez(folder / "a.npz", points=np.ones((20, 3), np.float32), radius=np.ones(20))
    np.savez_compressed(folder / "b.npz", points=np.ones((20, 3), np.float32), radius=np.ones(20))


def volume(folder: Path) -> None:
    from hyjax.geometry.tsdf import Volume, save_volume

    save_volume(folder / "a.npz", Volume(0.05, 0.2), 3)


def meshes(folder: Path) -> None:
    box = trimesh.creation.box()
    for name in ("a.ply", "b.glb"):
        save_mesh(folder / name, box)
    (folder / "c.ply").write_bytes(trimesh.exchange.ply.export_ply(box, encoding="ascii"))
    box.export(folder / "d.obj")
    (folder / "e.gltf").write_bytes(_gltf(box))


def meshes_with_files(folder: Path) -> None:
    """Meshes that name other files."""
    box = trimesh.creation.box()
    (folder / "a.obj").write_text("mtllib a.mtl\n" + trimesh.exchange.obj.export_obj(box))
    (folder / "a.mtl").write_text("newmtl a\nKd 1 1 1\n")
    for name, content in trimesh.exchange.gltf.export_gltf(box, merge_buffers=True).items():
        (folder / name).write_bytes(content)


def _gltf(mesh: trimesh.Trimesh) -> bytes:
    files = trimesh.exchange.gltf.export_gltf(mesh, merge_buffers=True)
    tree = json.loads(files["model.gltf"])
    for buffer in tree["buffers"]:
        content = base64.b64encode(files[buffer["uri"]]).decode()
        buffer["uri"] = f"data:application/octet-stream;base64,{content}"
    return json.dumps(tree).encode()


def live_messages(folder: Path) -> None:
    from reference.phone_layouts import box_room

    from hyjax.live.messages import write_live_frame

    stream = io.BytesIO()
    for frame in box_room(2):
        write_live_frame(stream, frame)
    (folder / "a.bin").write_bytes(stream.getvalue())
