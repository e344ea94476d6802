"""Shared by the experiments' tests: a small room, exported as a scan, and weights of LPIPS."""

from pathlib import Path

import numpy as np
import pytest
from reference.arkit_export import export_arkit_scan
from safetensors.numpy import save_file

from experiments import references
from hyjax.data.builtin_room import RoomCapture, load_room
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings

ALEXNET = ((11, 3, 64), (5, 64, 192), (3, 192, 384), (3, 384, 256), (3, 256, 256))


@pytest.fixture(scope="session")
def room() -> RoomCapture:
    """The built-in room in four small pictures."""
    return load_room(n_frames=4, width=160, height=120, quality=0.25, progress=False)


@pytest.fixture(scope="session")
def scan(room: RoomCapture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The room in ARKitScenes' layout, with a mesh as a phone scans it."""
    mesh = Scene.open(SceneSettings(), capture=room).mesh
    return export_arkit_scan(tmp_path_factory.mktemp("arkit"), room, mesh)


@pytest.fixture
def coarse_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fused reference of large voxels, which takes a tenth of the time."""
    monkeypatch.setattr(references, "VOXEL", 0.06)


@pytest.fixture(scope="session")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """AlexNet with random weights: the tables' way does not depend on what the network has learned."""
    rng, arrays = np.random.default_rng(0), {}
    for i, (width, fan_in, channels) in enumerate(ALEXNET):
        scale = (width * width * fan_in) ** -0.5
        arrays[f"AlexNet_0.Conv_{i}.kernel"] = rng.normal(0, scale, (width, width, fan_in, channels))
        arrays[f"AlexNet_0.Conv_{i}.bias"] = np.zeros(channels)
        arrays[f"NetLinLayer_{i}.Conv_0.kernel"] = rng.uniform(0, 1, (1, 1, channels, 1))
    file = tmp_path_factory.mktemp("weights") / "random.safetensors"
    save_file({name: array.astype(np.float32) for name, array in arrays.items()}, file)
    return file
