"""All readers: what makes their seeds, and what reads a mutated one."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from . import captures, corpus

UP = np.array([0.0, 0.0, 1.0])


class Reader(NamedTuple):
    """A reader.

    Attributes:
        make: writes the seeds into an empty folder.
        read: takes the path of a mutated file; or, if `whole`, that of the folder with one file mutated.
        whole: whether all files belong together.
        writes: whether reading changes files or leaves new ones beside them.
        extra: that it needs; empty for none.
        stream: whether it reads from a stream, and no file.
    """

    make: Callable[[Path], None]
    read: Callable[[Path], object]
    whole: bool = False
    writes: bool = False
    extra: str = ""
    stream: bool = False


def _capture(path: Path) -> object:
    from hyjax.data.registry import open_capture

    capture = open_capture(_inside(path), progress=False)
    return capture[0], capture.depth_reading(0) if capture.depth_count else None, capture.fingerprint


def _inside(path: Path) -> Path:
    """The one folder or archive in a folder, if there is just one entry."""
    entries = list(path.iterdir())
    return entries[0] if len(entries) == 1 else path


def _pairs(kind: str) -> Callable[[Path], object]:
    def read(path: Path) -> object:
        from hyjax.pairs.registry import open_pairs

        pairs = open_pairs(f"{kind}:{path}")
        return pairs[0], pairs.fingerprint

    return read


def _read_image(path: Path) -> object:
    from hyjax.util.images import read_image

    return read_image(path)


def _read_depth(path: Path) -> object:
    from hyjax.util.images import read_depth

    return read_depth(path)


def _read_labels(path: Path) -> object:
    from hyjax.util.images import read_labels

    return read_labels(path)


def _shape(path: Path) -> object:
    from hyjax.util.images import picture_shape

    return picture_shape(path)


def _schedule(path: Path) -> object:
    from hyjax.relighting.settings import read_schedule

    return str(read_schedule(path))


def _configuration(path: Path) -> object:
    from hyjax.configuration import Configuration

    return Configuration.open(str(path))


def _device_latency(path: Path) -> object:
    from hyjax.tuning.device_latency import read_latency

    return read_latency(path).fingerprint


def _tour_plan(path: Path) -> object:
    from hyjax.tour.plan import TourPlan
    from hyjax.util.reading import read_text

    return TourPlan.from_json(read_text(path)).to_json()


def _lights(path: Path) -> object:
    from hyjax.data.light_file import read_lights

    return read_lights(path, UP, warn=False)


def _photo_sources(path: Path) -> object:
    from hyjax.photo_light.sources import read_sources

    return read_sources(path, UP, _caster(), np.array([[0.0, 0.0, 1.5]]))


def _caster() -> Any:
    import trimesh

    from hyjax.geometry.raycast import RayCaster

    if "caster" not in _made:
        _made["caster"] = RayCaster(trimesh.creation.box((4.0, 4.0, 3.0)).apply_translation([0, 0, 1.5]))
    return _made["caster"]


_made: dict[str, Any] = {}


def _sweep_spec(path: Path) -> object:
    from hyjax.sweep.spec import read_spec

    return read_spec(path)


def _sweep_rows(path: Path) -> object:
    from hyjax.sweep.rows import RowStore

    store = RowStore(path)
    return list(store.read()), store.duplicates(), store.driver(), store.get("0")


def _run_log(path: Path) -> object:
    from hyjax.util.run_log import read_lines

    return read_lines(path, lambda line: "k" in line, "a line with k")


def _training_run(path: Path) -> object:
    from hyjax.training.log import TrainingLog
    from hyjax.training.settings import TrainSettings

    log = TrainingLog(path, TrainSettings(iterations=10), resume=True)
    lines = [line for line in log.lines if line["iteration"] <= 3]
    return lines, log.validations(), log.last_is_best()


def _study(path: Path) -> object:
    from hyjax.tuning.study import Study

    kept = Study(path, "frame", {"seed": 0}, resume=True)
    return kept.trials, kept.remember("refined", lambda: 1)


def _kept_trials(path: Path) -> object:
    from hyjax.tuning.study import kept_trials

    return kept_trials(path)


def _results(path: Path) -> object:
    from experiments.records import is_finished, read_rows

    return is_finished(read_rows(path))


def _web_page(path: Path) -> object:
    from hyjax.export.web import check_page_folder

    return check_page_folder(path)


def _live(path: Path) -> object:
    from hyjax.live.messages import read_live_frames

    return list(read_live_frames(io.BytesIO(path.read_bytes())))


def _measuring(path: Path) -> object:
    from hyjax.tuning.device_measuring import Measuring

    site, content = Measuring(lambda line: None), path.read_bytes()
    return [site.post(address, content) for address in ("hello", "round", "trouble", "alive")]


def _messages_of_devices(folder: Path) -> None:
    hello = b'{"name": "Phone", "adapter": "a", "agent": "b", "timer": "gpu"}'
    (folder / "a.json").write_bytes(hello)
    (folder / "b.json").write_bytes(b'{"job": 1, "milliseconds": [1.0, 2.0], "last": false, "error": "x"}')


def _trajectory(path: Path) -> object:
    from hyjax.data.arkit_scenes import read_pincam
    from hyjax.data.trajectory import read_trajectory
    from hyjax.data.trees import open_tree

    if path.suffix == ".pincam":
        return read_pincam(open_tree(path), path.name)
    trajectory = read_trajectory(open_tree(path), path.name)
    return trajectory.pose_at(trajectory.times[0])


def _colmap_map(path: Path) -> object:
    from hyjax.data.colmap_files import read_array
    from hyjax.util.reading import read_bytes

    return read_array(read_bytes(path), str(path))


def _video(path: Path) -> object:
    from hyjax.data.trees import open_tree
    from hyjax.data.video_frames import VideoFrames

    return VideoFrames(open_tree(path), path.name).read(0)


def _weights(path: Path) -> object:
    from hyjax.guide.weights import read_weights

    return read_weights(path)


def _cache(path: Path) -> object:
    from hyjax.util.cache import cached_arrays

    made = {"points": np.ones((2, 3))}
    return cached_arrays(path, lambda arrays: arrays["points"].shape, lambda: made)


def _volume(path: Path) -> object:
    from hyjax.geometry.tsdf import load_volume

    return load_volume(path, 0.05, 0.2)


def _mesh(path: Path) -> object:
    from hyjax.geometry.mesh import load_mesh

    return load_mesh(path, repair=True)


def _meshes(folder: Path) -> object:
    return [_mesh(folder / name) for name in ("a.obj", "model.gltf")]


READERS: dict[str, Reader] = {
    "png": Reader(corpus.pngs, _read_image),
    "jpeg": Reader(corpus.jpegs, _read_image),
    "exr": Reader(corpus.exrs, _read_image),
    "pnm": Reader(corpus.pnms, _read_image),
    "tiff": Reader(corpus.tiffs, _read_image),
    "webp": Reader(corpus.webps, _read_image),
    "bmp": Reader(corpus.bmps, _read_image),
    "depth map": Reader(corpus.depths, _read_depth),
    "labels": Reader(corpus.labels, _read_labels),
    "picture size": Reader(corpus.pictures, _shape),
    "schedule": Reader(corpus.schedules, _schedule),
    "configuration": Reader(corpus.configurations, _configuration),
    "device latency": Reader(corpus.device_latencies, _device_latency),
    "device message": Reader(_messages_of_devices, _measuring, stream=True),
    "tour plan": Reader(corpus.tour_plans, _tour_plan, extra="tour"),
    "lights": Reader(corpus.lights, _lights),
    "photo sources": Reader(corpus.photo_sources, _photo_sources),
    "sweep spec": Reader(corpus.sweep_specs, _sweep_spec),
    "sweep rows": Reader(corpus.sweep_rows, _sweep_rows, True),
    "run log": Reader(corpus.run_logs, _run_log),
    "training run": Reader(corpus.training_run, _training_run, True, True),
    "study": Reader(corpus.study, _study, True, True, extra="tune"),
    "kept trials": Reader(corpus.study, _kept_trials, writes=True, extra="tune"),
    "results": Reader(corpus.rows_of_results, _results),
    "web page": Reader(corpus.web_page, _web_page, True),
    "live messages": Reader(corpus.live_messages, _live, stream=True),
    "7-Scenes": Reader(captures.seven_scenes, _capture, True),
    "ARKitScenes": Reader(captures.arkit, _capture, True),
    "3D Scanner App": Reader(captures.scanner3d, _capture, True),
    "Record3D": Reader(captures.record3d, _capture, True),
    "Record3D archive": Reader(captures.r3d, _capture, True, extra="captures"),
    "Stray Scanner": Reader(captures.stray, _capture, True, extra="captures"),
    "Polycam": Reader(captures.polycam, _capture, True),
    "nerfstudio": Reader(captures.published("test_nerfstudio"), _capture, True),
    "COLMAP text": Reader(captures.published("test_colmap", binary=False), _capture, True, extra="captures"),
    "COLMAP binary": Reader(captures.published("test_colmap"), _capture, True, extra="captures"),
    "COLMAP depth": Reader(captures.colmap_map, _colmap_map, extra="captures"),
    "TUM": Reader(captures.published("test_tum"), _capture, True),
    "ScanNet": Reader(captures.scannet, _capture, True),
    "Redwood": Reader(captures.published("test_redwood"), _capture, True),
    "ZIP archive": Reader(captures.archive, _capture, True),
    "trajectory": Reader(captures.trajectory, _trajectory),
    "video": Reader(captures.video, _video, extra="captures"),
    "pairs in a folder": Reader(captures.pairs_folder, _pairs("folder"), True),
    "DIML": Reader(captures.diml, _pairs("diml"), True),
    "Middlebury": Reader(captures.middlebury, _pairs("middlebury"), True),
    "Middlebury 2014": Reader(captures.middlebury_pfm, _pairs("middlebury"), True),
    "NYU": Reader(captures.nyu, _pairs("nyu"), extra="nyu"),
    "safetensors": Reader(corpus.safetensors, _weights),
    "mesh": Reader(corpus.meshes, _mesh),
    "mesh with its files": Reader(corpus.meshes_with_files, _meshes, True),
    "cached arrays": Reader(corpus.arrays, _cache, writes=True),
    "fusion checkpoint": Reader(corpus.volume, _volume, writes=True),
}
"""By name, as tables have them."""
