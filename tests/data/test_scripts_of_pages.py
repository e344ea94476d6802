"""Scripts that pages show for folders from and to other tools."""

import os
import re
import subprocess
import textwrap
from pathlib import Path

import numpy as np
import pytest
import small_capture as small
from extras import needs_blender
from PIL import Image
from test_nerfstudio import change, load, save, write

import hyjax
from hyjax.data.registry import open_capture
from hyjax.scene.blender import blender_python

DOCS = Path(__file__).parents[2] / "docs"
BOX = """
import bpy, mathutils
bpy.ops.wm.read_factory_settings(use_empty=True)
scene, new = bpy.context.scene, bpy.data
bpy.ops.mesh.primitive_cube_add(size=1, location=(0.2, 1.0, 0.4), scale=(1.2, 0.6, 0.8))
material = new.materials.new("white")
material.use_nodes = True
nodes = material.node_tree.nodes
emission = nodes.new("ShaderNodeEmission")
material.node_tree.links.new(emission.outputs[0], nodes["Material Output"].inputs[0])
bpy.context.object.data.materials.append(material)
scene.camera = new.objects.new("camera", new.cameras.new("camera"))
scene.collection.objects.link(scene.camera)
for number in (1, 2):
    scene.camera.location = (-1.2 + number, -2.2, 1.4)
    direction = mathutils.Vector((0.3, 0.9, 0.5)) - mathutils.Vector(scene.camera.location)
    scene.camera.rotation_euler = direction.to_track_quat("-Z", "Y").to_euler()
    for key in ("location", "rotation_euler"):
        scene.camera.keyframe_insert(key, frame=number)
scene.frame_start, scene.frame_end = 1, 2
scene.render.engine, scene.cycles.samples = "CYCLES", 4
scene.render.resolution_x, scene.render.resolution_y = 96, 64
"""
"""A white box before black, and a camera that moves."""


def script(page: str) -> str:
    """Longest indented block of a page."""
    blocks = re.findall(r"(?:^    .*\n(?:\n(?=    ))?)+", (DOCS / page).read_text(encoding="utf-8"), re.MULTILINE)
    return textwrap.dedent(max(blocks, key=len))


def test_relit_pictures_become_a_nerfstudio_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, relit = write(tmp_path / "room"), tmp_path / "relit"
    (source / "points.ply").write_bytes(b"ply")
    content = load(source)
    lost = content["frames"][0] | {"file_path": "images/lost.jpg"}
    save(source, content | {"frames": [lost, *content["frames"]], "ply_file_path": "points.ply"})
    change(source, k1=0.3, train_filenames=["images/frame_0.jpg"])
    for index in range(small.COUNT):
        small.save_picture(relit / f"frame_{index}.relit.png", small.picture(index))
    monkeypatch.chdir(tmp_path)
    exec(script("from_nerfstudio.md"), {})
    small.check_same(relit)
    assert (relit / "points.ply").exists() and "train_filenames" not in load(relit)


@needs_blender
@pytest.mark.slow
def test_blender_writes_frames_and_mesh_that_fit(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(BOX + script("from_blender.md"))
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    subprocess.run([blender_python(), "script.py"], cwd=tmp_path, env=clean, check=True, capture_output=True)
    room = tmp_path / "room"
    assert len(open_capture(room, scale=1.0)) == 2
    scene = hyjax.Scene.open(hyjax.SceneSettings(capture=room, mesh=str(room / "room.ply"), scale=1.0))
    for index in range(2):
        picture = np.asarray(Image.open(room / "images" / f"{index + 1:03}.png").convert("L"))
        white, hit = picture > 127, np.asarray(scene.gbuffer(scene.frame(index).camera).hit)
        assert 0.05 < white.mean() < 0.9 and (white == hit).mean() > 0.98
