"""Worker of `hyjax.scene.blender` inside Blender: in any Python that has `bpy`, without hyjax.

    python -P blender_worker.py FOLDER

FOLDER holds `geometry.npz` (vertices, faces, normals) and `job.json` (lights). Each line on stdin is a camera
and the pictures to render with it, as JSON. Each picture becomes the EXR file that it names; `@hyjax done` on
stdout answers.

One light shines at a time on white diffuse paint, without any bounce, so that a pixel's radiance is E/π. Cycles is
physical: a point or spot of P watts has the intensity P/4π (the cone only masks it), a rectangle the radiance
P/(π A), and a sun's strength is its irradiance on a surface that faces it. A watt here stands for a lumen.
"""

import json
import math
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

FILTER_WIDTH = 0.01
"""Width of the pixel filter in pixels, Blender's least: rays go through the pixels' centres."""
SENSOR_WIDTH = 36.0
"""Width of the sensor in millimetres; any would do."""
KINDS = {"point": "POINT", "spot": "SPOT", "directional": "SUN", "rect": "AREA"}


def main() -> None:
    """Build the scene, then render requested pictures until stdin ends."""
    folder = Path(sys.argv[1])
    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    with np.load(folder / "geometry.npz") as geometry:
        scene = BlenderScene(**geometry)
    lamps = [light and scene.add_lamp(light) for light in job["lights"]]
    print("@hyjax ready", flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        scene.aim(**request["camera"])
        for picture in request["pictures"]:
            index = picture["light"]
            light, lamp = (None, None) if index is None else (job["lights"][index], lamps[index])
            scene.switch_on(light, lamp, picture["shadows"], picture["soft"])
            scene.shoot(picture["file"], picture["samples"])
        print("@hyjax done", flush=True)


class BlenderScene:
    """Blender scene: one surface, one camera, lamps of which one at a time is on."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> None:
        self.scene = bpy.context.scene
        for thing in list(self.scene.objects):
            bpy.data.objects.remove(thing)
        _set_up(self.scene)
        self.paint = Paint()
        self.surface = self._add(_mesh("surface", vertices, faces, normals))
        self.surface.data.materials.append(self.paint.material)
        self.camera = self._add(bpy.data.cameras.new("camera"))
        self.scene.camera = self.camera
        self.reach = 100.0 * float(np.linalg.norm(np.ptp(vertices, axis=0)))
        self.shutters: dict[int, Any] = {}

    def _add(self, data: Any) -> Any:
        thing = bpy.data.objects.new(data.name, data)
        self.scene.collection.objects.link(thing)
        return thing

    def add_lamp(self, light: dict[str, Any]) -> Any:
        """Add the lamp object of a light; None for a sky, which is the scene's world."""
        if light["kind"] == "sky":
            return None
        data = bpy.data.lights.new(light["kind"], KINDS[light["kind"]])
        data.energy = light["strength"]
        data.cycles.use_multiple_importance_sampling = False
        lamp = self._add(data)
        lamp.hide_render = True
        if light["kind"] == "rect":
            right, up = Vector(light["right"]), Vector(light["up"])
            data.shape, data.size, data.size_y = "RECTANGLE", 2 * right.length, 2 * up.length
            # Blender's rectangles shine along their −z.
            columns = [axis.normalized() for axis in (right, -up, -right.cross(up))]
            lamp.matrix_world = Matrix.Translation(light["position"]) @ Matrix(columns).transposed().to_4x4()
            return lamp
        if light["kind"] != "point":
            lamp.rotation_euler = Vector(light["direction"]).to_track_quat("-Z", "Y").to_euler()
        if light["kind"] != "directional":
            data.use_soft_falloff = False
            lamp.location = light["position"]
        if light["kind"] == "spot":
            # Blender's cone is a smoothstep of the cosine, as ours is.
            inner, outer = (math.cos(light[f"{name}_angle"]) for name in ("inner", "outer"))
            data.spot_size, data.spot_blend = 2 * light["outer_angle"], (inner - outer) / (1 - outer)
        if light.get("aperture"):
            shutter = self._add(_mesh("shutter", *_shutter(light["aperture"], self.reach), None))
            shutter.visible_camera, shutter.hide_render = False, True
            self.shutters[id(light)] = shutter
        return lamp

    def aim(self, width: int, height: int, fx: float, fy: float, cx: float, cy: float, pose: list) -> None:
        """Set the camera by intrinsics in pixels and a camera-to-world pose (+x right, +y down, +z forward)."""
        render, lens = self.scene.render, self.camera.data
        render.resolution_x, render.resolution_y = width, height
        render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, fy / fx), max(1.0, fx / fy)
        lens.sensor_fit, lens.sensor_width, lens.lens = "HORIZONTAL", SENSOR_WIDTH, SENSOR_WIDTH * fx / width
        lens.clip_start, lens.clip_end = 1e-4, self.reach
        lens.shift_x = (0.5 * width - cx) / width
        lens.shift_y = (cy - 0.5 * height) / width * fx / fy
        self.camera.matrix_world = Matrix(pose) @ Matrix.Diagonal((1, -1, -1, 1))

    def switch_on(self, light: dict[str, Any] | None, lamp: Any, shadows: bool, soft: bool) -> None:
        """Turn on one light alone, with or without shadows, with or without its extent; None for darkness."""
        for other in self.scene.objects:
            if other.type == "LIGHT":
                other.hide_render = other is not lamp
        for key, shutter in self.shutters.items():
            shutter.hide_render = not (shadows and key == id(light))
        light = light or {"kind": "none"}
        if light["kind"] == "directional":
            lamp.data.angle = 2 * light["extent"] * soft
        elif light["kind"] in ("point", "spot"):
            lamp.data.shadow_soft_size = light["extent"] * soft
        # The sky is found by rays that leave the surface as reflections do.
        self.surface.visible_shadow = self.surface.visible_diffuse = shadows
        self._set_sky(light)
        self.paint.expose(light if shadows else {})

    def _set_sky(self, light: dict[str, Any]) -> None:
        """Set the sky: a white hemisphere around `up`; black for any other light."""
        tree = self.scene.world.node_tree
        tree.nodes.clear()
        background = tree.nodes.new("ShaderNodeBackground")
        background.inputs["Strength"].default_value = 0.0
        if light["kind"] == "sky":
            background.inputs["Strength"].default_value = light["strength"] / math.pi
            direction = tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"]
            height = _math(tree, "DOT_PRODUCT", direction, light["direction"])
            tree.links.new(_math(tree, "GREATER_THAN", height, 0.0), background.inputs["Color"])
        tree.links.new(background.outputs[0], tree.nodes.new("ShaderNodeOutputWorld").inputs["Surface"])

    def shoot(self, file: str, samples: int) -> None:
        """Render to an EXR file: radiance and alpha, and depth."""
        self.scene.cycles.samples = samples
        self.scene.render.filepath = file
        bpy.ops.render.render(write_still=True)


class Paint:
    """White diffuse paint, some of which lets shadow rays through.

    Surfaces nearer to a lamp than its clearance, or before the opening, cast no shadow. Before the opening the
    paint is black, too: no light comes in through it.
    """

    def __init__(self) -> None:
        self.material = bpy.data.materials.new("paint")
        self.material.use_nodes = True
        self.tree = self.material.node_tree

    def expose(self, light: dict[str, Any]) -> None:
        """Rebuild the paint for one light's shadows."""
        tree = self.tree
        tree.nodes.clear()
        surface = tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"]
        diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse")
        diffuse.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
        diffuse.inputs["Roughness"].default_value = 0.0
        ray = tree.nodes.new("ShaderNodeLightPath").outputs
        place = tree.nodes.new("ShaderNodeNewGeometry").outputs["Position"]
        exempt = []
        if light.get("clearance", 0.0) > 0:
            away = _math(tree, "DISTANCE", place, light["position"])
            exempt.append(_math(tree, "LESS_THAN", away, light["clearance"]))
        if light.get("aperture"):
            opening, direction = light["aperture"], Vector(light["direction"])
            inwards = Vector(opening["right"]).cross(Vector(opening["up"])).normalized()
            inwards *= math.copysign(1.0, inwards.dot(direction))
            side = _math(tree, "DOT_PRODUCT", _math(tree, "SUBTRACT", place, opening["center"]), inwards)
            exempt.append(_math(tree, "LESS_THAN", side, 0.0))
            tree.links.new(_math(tree, "GREATER_THAN", side, 0.0), diffuse.inputs["Color"])
        if not exempt:
            tree.links.new(diffuse.outputs[0], surface)
            return
        passes = exempt[0]
        for other in exempt[1:]:
            passes = _math(tree, "MAXIMUM", passes, other)
        mix = tree.nodes.new("ShaderNodeMixShader")
        tree.links.new(_math(tree, "MULTIPLY", passes, ray["Is Shadow Ray"]), mix.inputs["Fac"])
        tree.links.new(diffuse.outputs[0], mix.inputs[1])
        tree.links.new(tree.nodes.new("ShaderNodeBsdfTransparent").outputs[0], mix.inputs[2])
        tree.links.new(mix.outputs[0], surface)


def _math(tree: Any, operation: str, a: Any, b: Any) -> Any:
    """Output of a math node: `a` is a socket, `b` a socket, a number or a vector."""
    vector = operation in ("DOT_PRODUCT", "DISTANCE", "SUBTRACT")
    node = tree.nodes.new("ShaderNodeVectorMath" if vector else "ShaderNodeMath")
    node.operation = operation
    tree.links.new(a, node.inputs[0])
    if isinstance(b, bpy.types.NodeSocket):
        tree.links.new(b, node.inputs[1])
    else:
        node.inputs[1].default_value = b
    return node.outputs["Value" if operation != "SUBTRACT" else "Vector"]


def _set_up(scene: Any) -> None:
    """Set the output to linear float pixels of direct light, without any beautification."""
    scene.render.engine = "CYCLES"
    cycles, render, image = scene.cycles, scene.render, scene.render.image_settings
    cycles.device = "CPU"
    cycles.max_bounces = 0
    cycles.transparent_max_bounces = 1024
    cycles.pixel_filter_type, cycles.filter_width = "GAUSSIAN", FILTER_WIDTH  # a box ignores its width
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_light_tree = False
    cycles.sample_clamp_direct = cycles.light_sampling_threshold = 0.0
    render.use_persistent_data = True
    render.film_transparent = True
    render.use_compositing = render.use_sequencer = False
    render.resolution_percentage = 100
    image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth, image.exr_codec = "OPEN_EXR_MULTILAYER", "32", "NONE"
    image.use_exr_interleave = True  # in parts, files with oblong pixels cannot be written
    scene.view_layers[0].use_pass_z = True
    scene.view_settings.view_transform = "Raw"
    scene.world = bpy.data.worlds.new("sky")
    scene.world.use_nodes = True
    scene.world.cycles.sampling_method = "NONE"  # reflected rays find it, with the cosine's density


def _mesh(name: str, vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray | None) -> Any:
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(vertices, np.float32).ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", np.ascontiguousarray(faces, np.int32).ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, faces.shape[1], dtype=np.int32))
    mesh.update(calc_edges=True)
    if normals is not None:
        mesh.polygons.foreach_set("use_smooth", np.ones(len(faces), bool))
        stored = mesh.attributes.new("custom_normal", "FLOAT_VECTOR", "POINT")
        stored.data.foreach_set("vector", np.ascontiguousarray(normals, np.float32).ravel())
    return mesh


def _shutter(aperture: dict[str, Any], reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Shutter: a plane around an opening, as four quads."""
    center, right, up = (np.array(aperture[key]) for key in ("center", "right", "up"))
    far = 1.0 + reach / min(np.linalg.norm(right), np.linalg.norm(up))
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    vertices = [center + k * (s * right + t * up) for k in (1.0, far) for s, t in corners]
    return np.array(vertices), np.array([[i, (i + 1) % 4, (i + 1) % 4 + 4, i + 4] for i in range(4)])


if __name__ == "__main__":
    main()
