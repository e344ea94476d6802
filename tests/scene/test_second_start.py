"""A second start finds what the first one made, and loads nothing that only making needs."""

import subprocess
import sys

import pytest

START = """
import sys
import hyjax.relighting.run
from hyjax.data.builtin_room import load_room
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings

room = load_room(n_frames=4, width=160, height=120, quality=0.25, progress=False)
scene = Scene.open(SceneSettings(), capture=room)
maps = scene.shadow_maps(scene.lights("golden-hour"))
seen = scene.gbuffer(room.camera(0), rays=True)
print(sum(float(abs(m.depth[0, 20:40]).sum()) for m in maps if m is not None), float(seen.depth.sum()))
print(*sorted({"trimesh", "scipy", "networkx", "numba", "skimage", "matplotlib"} & set(sys.modules)))
"""


@pytest.mark.slow
def test_a_second_start_loads_no_geometry_library() -> None:
    first, second = (
        subprocess.run(
            [sys.executable, "-c", START], capture_output=True, text=True, check=True, timeout=300
        ).stdout
        for _ in range(2)
    )
    assert second.splitlines() == [first.splitlines()[0], ""]
