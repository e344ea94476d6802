"""Shaders of a whole frame: surface, lights with shadows, bounces, both cascades, composite.

The mirror of `hyjax.pipeline.relight` in mode `linear`, with shadow maps, and the photo's own light divided out.
"""

import dataclasses

from hyjax.core.schedule import Schedule
from hyjax.device.cascade_program import CascadeWriter
from hyjax.device.program import Groups, Precision, Program, columns_rows, grid_of, line_of
from hyjax.light.panes import MOST_BARS
from hyjax.light.transport import BOUNCES

RECORD_BYTES = 128
"""Size of a light's record in bytes, see `hyjax.device.light_records`."""
FRAME_BYTES = 128
"""Size of a frame's record (camera and data of all passes) in bytes, see `wgsl/camera.wgsl`."""
MOST_LIGHTS = 32
MOST_EMITTERS = 64
EMITTER_VECTORS = 7 + MOST_BARS
"""Number of vectors of a pane, see `wgsl/composite.wgsl`; a lamp has three."""
LEAF_TRIANGLES = 4
"""Number of triangles of a leaf of the ray-casting tree."""
POINT_FIELDS = 4
"""Number of vectors of a point: position, normal, photo's light, albedo."""
LIGHT_GROUPS = Groups(2, 1)
"""Channel groups of light: bounced light with the weight; photo's light; four lights a group."""
JOINED_GROUPS = Groups(2, 3)
"""Channel groups of light, then of weighted visibility, then of its weights."""
VIEW_BYTES = 64
"""Size of a view of a shadow map in bytes, see `wgsl/views.wgsl`."""
MOST_VIEWS = 32
"""Most views of a light."""


@dataclasses.dataclass(frozen=True)
class SceneCounts:
    """Numbers of a scene's elements.

    Attributes:
        faces: triangles of the scan.
        vertices: of the scan.
        points: of the light transport: vertices, then patches of the box that closes the scan.
        rays: of each point.
        sources: that lit the photos.
        occluder_faces: triangles of the mesh that casts shadows.
        occluder_vertices: of it.
    """

    faces: int
    vertices: int
    points: int
    rays: int
    sources: int
    occluder_faces: int
    occluder_vertices: int

    @property
    def leaves(self) -> int:
        """Number of leaves of the tree over the occluders, a power of two."""
        return 1 << max(0, (-(-self.occluder_faces // LEAF_TRIANGLES) - 1).bit_length())


def frame_program(
    counts: SceneCounts,
    size: tuple[int, int],
    schedule: Schedule,
    shadow_schedule: Schedule,
    *,
    features: int = 3,
    precision: Precision = "f32",
    stages: bool = True,
) -> Program:
    """Generate the program of a scene's frames.

    The host fills the buffers `vertices`, `occluders` (triangles in the order of their tree), `faces`, `fields`,
    `hits`, `sources` once; `lights`, `views`, `kept`, `emitters` and `jobs` where lights change, whose shadow maps
    are in `depths`, which it makes as large as they need; `frame` and the texture `photo` for each picture.

    Args:
        size: (height, width) of the frames.
        features: channels of the guide; the RGB guide, which is the picture itself, has 3.
        stages: whether there is a stage `stages`, whose pictures take four times the memory of the image.
    """
    program = Program(size, precision)
    _load(program, counts)
    _shadows(program, counts)
    _bounces(program, counts)
    picture = program.picture("picture", size, Groups(1))
    grid = grid_of(size)
    camera: dict[str, object] = {"size": columns_rows(size)}
    program.launch("photo", "picture", ["frame", "camera", "picture"], ["photo", picture], grid, constants=camera)
    guide = picture if features == 3 else program.picture("guide", size, Groups(-(-features // 4)))
    # What is known of the light and of the visibility is repaired together where one schedule does for both.
    filling = Schedule.preset("hyjax")
    joined = schedule.to_json() == filling.to_json()
    light, visibility = _surface(program, counts, joined)
    writer = CascadeWriter(program, guide, features)
    if joined:
        repaired = filled = writer.levels("cascade", light, schedule, JOINED_GROUPS, total=True)
    else:
        repaired = writer.levels("cascade", light, schedule, LIGHT_GROUPS, total=True)
        filled = writer.levels("filling", visibility, filling, Groups(0, 2), total=True)
    visible_totals = "cascade totals" if joined else "filling totals"
    complete = program.picture("visibility filled", size, Groups(0, 1))
    guides, constants = writer.interpolation(filled, 4)
    bind = [visibility, filled.buffer, visible_totals, complete, *guides]
    constants["first"] = _first(joined, "count.z")
    program.launch(
        "frame", "filling", ["filled", "interpolate", "fill"], bind, grid, Groups(0, 1), constants=constants
    )
    shadows = writer.cascade("shadow pass", complete, shadow_schedule, Groups(0, 1))
    image = program.buffer("image", 16 * size[0] * size[1])
    guides, constants = writer.interpolation(repaired, 9)
    totals = "cascade totals"
    bind = ["frame", "lights", "emitters", picture, "surface", repaired.buffer, totals, shadows, image, *guides]
    files = ["frame", "camera", "color", "filled", "interpolate", "lights", "composite"]
    constants |= camera | {"emitters": EMITTER_VECTORS * MOST_EMITTERS, "pane": EMITTER_VECTORS}
    constants |= {"lights": MOST_LIGHTS}
    program.launch("frame", "composite", files, bind, grid, constants=constants)
    refined = writer.upsample("cascade", repaired, LIGHT_GROUPS, stage="refined")
    if stages:
        filters = program.buffer("stages", 4 * 16 * size[0] * size[1])
        bind = ["frame", "lights", light, refined, totals, visibility, shadows, filters]
        files = ["frame", "camera", "filled", "lights", "stages"]
        first = {"first": _first(joined, "groups")}
        program.launch("stages", "stages", files, bind, grid, constants=camera | first)
    program.names = {
        "raw": light,
        "refined": refined,
        "visibility": shadows,
        "image": image,
        "visible totals": visible_totals,
    }
    return program


def _first(joined: bool, groups: str) -> str:
    """Shader text of the plane at which visibility begins, beside the light or by itself."""
    return f"2u + {groups}" if joined else "0u"


def _load(program: Program, counts: SceneCounts) -> None:
    """Boxes of the tree over the occluders, depth by depth."""
    program.buffer("vertices", 12 * counts.occluder_vertices)
    program.buffer("occluders", 12 * counts.occluder_faces)
    boxes = program.buffer("boxes", 64 * counts.leaves)
    depth = counts.leaves
    while depth:
        first = program.buffer(f"depth {depth}", 16, uniform=True, initial=(depth - 1, depth, 0, 0))
        bind = ["vertices", "occluders", boxes, first]
        grid = line_of(depth)
        program.launch("load", "tree", ["trace", "boxes"], bind, grid, constants=_tree(counts, "read_write"))
        depth //= 2


def _tree(counts: SceneCounts, access: str) -> dict[str, object]:
    return {"leaves": counts.leaves, "leaf": LEAF_TRIANGLES, "faces": counts.occluder_faces, "boxes_access": access}


def _shadows(program: Program, counts: SceneCounts) -> None:
    program.buffer("lights", RECORD_BYTES * MOST_LIGHTS, uniform=True)
    program.buffer("views", VIEW_BYTES * MOST_VIEWS * MOST_LIGHTS)
    program.buffer("jobs", 16 * MOST_VIEWS * MOST_LIGHTS)
    program.launch(
        "shadows",
        "shadow maps",
        ["trace", "cast", "lights", "views", "shadow_map"],
        ["vertices", "occluders", "boxes", "lights", "jobs", "depths", "views"],
        (1, 1),
        jobs=True,
        constants=_tree(counts, "read"),
    )


def _bounces(program: Program, counts: SceneCounts) -> None:
    program.buffer("frame", FRAME_BYTES, uniform=True)
    program.buffer("faces", 12 * counts.faces)
    fields = program.buffer("fields", 16 * POINT_FIELDS * counts.points)
    direct, indirect = (program.buffer(name, 16 * counts.points) for name in ("direct", "indirect"))
    radiators = counts.faces + counts.points - counts.vertices + 1
    sent, hits = program.buffer("sent", 16 * radiators), program.buffer("hits", 4 * counts.rays * counts.points)
    points: dict[str, object] = {"points": counts.points}
    bind = ["frame", "lights", "depths", fields, direct, indirect, "views"]
    line = line_of(counts.points)
    files = ["frame", "lights", "views", "visibility", "direct"]
    program.launch("bounces", "direct light", files, bind, line, constants=points)
    for _ in range(BOUNCES):
        bind = ["faces", fields, direct, indirect, sent]
        constants: dict[str, object] = {"faces": counts.faces, "vertices": counts.vertices}
        program.launch("bounces", "bounces", ["send"], bind, line_of(radiators), constants=constants | points)
        program.launch(
            "bounces", "bounces", ["gather"], [hits, sent, indirect], line, constants=points | {"rays": counts.rays}
        )
    program.buffer("sources", max(16, 12 * counts.sources * counts.vertices))
    program.buffer("kept", 16 * (counts.sources + 1))
    bounced = program.buffer("bounced", 16 * counts.vertices)
    constants = {"vertices": counts.vertices, "sources": counts.sources}
    bind = [indirect, "sources", "kept", bounced]
    program.launch("bounces", "bounces", ["kept"], bind, line_of(counts.vertices), constants=constants)


def _surface(program: Program, counts: SceneCounts, joined: bool) -> tuple[str, str]:
    """Buffers of the light on the visible surface, and of its weighted visibility with the weights.

    They are one if joined.
    """
    size, grid = program.size, grid_of(program.size)
    pixels = size[0] * size[1]
    camera: dict[str, object] = {"size": columns_rows(size)}
    program.launch(
        "frame",
        "surface",
        ["frame", "camera", "raster"],
        ["frame", "faces", "fields"],
        (3 * counts.faces, 1),
        constants=camera,
    )
    surface = program.buffer("surface", 16 * pixels)
    light = program.picture("light", size, JOINED_GROUPS if joined else LIGHT_GROUPS)
    visibility = light if joined else program.picture("visibility", size, Groups(0, 2))
    bind = ["frame", "shown", "faces", "fields", "bounced", surface, light, "picture"]
    program.launch("frame", "surface", ["frame", "camera", "color", "surface"], bind, grid, constants=camera)
    bind = ["frame", "lights", "depths", surface, light, "views", *([] if joined else [visibility])]
    files = ["frame", "camera", "lights", "views", "visibility", "shade"]
    apart = "@group(0) @binding(6) var<storage, read_write> visibility: array<Stored>;"
    constants = camera | {
        "visibility": "light" if joined else "visibility",
        "visibility_binding": "" if joined else apart,
        "first": _first(joined, "count.z"),
    }
    program.launch("frame", "shading and visibility", files, bind, grid, Groups(0, 1), constants=constants)
    program.buffer("emitters", 16 * EMITTER_VECTORS * MOST_EMITTERS, uniform=True)
    return light, visibility
