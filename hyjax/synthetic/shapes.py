"""Solids of charts, in metres; normals point outwards."""

import itertools
from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float

from hyjax.synthetic.surface import WHITE, Builder, Color, Grid, even_st, weld

# Largest edge of a flat panel's triangles.
PANEL_STEP = 0.3


def panel(
    build: Builder,
    origin: Sequence[float],
    along_s: Sequence[float],
    along_t: Sequence[float],
    material: int,
    tint: Color = WHITE,
    holes: Sequence[tuple[float, float, float, float]] = (),
    texel: float = 0.045,
    stretch: float | None = None,
) -> None:
    """A flat rectangle with normal s × t; `holes` are (s0, t0, s1, t1) in metres from `origin`.

    The texture is laid on in metres, or once over the whole rectangle, shifted sideways by the share `stretch`.
    """
    o, ds, dt = (np.asarray(v, dtype=float) for v in (origin, along_s, along_t))
    size = np.array([np.linalg.norm(ds), np.linalg.norm(dt)])
    breaks = []
    for axis in (0, 1):
        cuts = np.unique([0.0, size[axis], *(h[axis] for h in holes), *(h[axis + 2] for h in holes)])
        pieces = [np.linspace(a, b, max(2, int(np.ceil((b - a) / PANEL_STEP)) + 1)) for a, b in
                  itertools.pairwise(cuts)]  # fmt: skip
        breaks.append(np.unique(np.round(np.concatenate(pieces), 9)))
    t, s = np.meshgrid(breaks[1], breaks[0], indexing="ij")
    middle_s, middle_t = (s[:-1, :-1] + s[1:, 1:]) / 2, (t[:-1, :-1] + t[1:, 1:]) / 2
    keep = np.ones(middle_s.shape, dtype=bool)
    for s0, t0, s1, t1 in holes:
        keep &= ~((middle_s > s0) & (middle_s < s1) & (middle_t > t0) & (middle_t < t1))
    st = np.stack([s, t], axis=-1) / size
    points = o + st[..., :1] * ds + st[..., 1:] * dt
    index = np.arange(s.size).reshape(s.shape)
    build.add(
        points.reshape(-1, 3),
        [Grid(index, st * size if stretch is None else st + np.array([stretch, 0.0]), st, keep)],
        material,
        tint,
        texel,
    )


def box(
    build: Builder,
    low: Sequence[float],
    high: Sequence[float],
    material: int,
    tint: Color = WHITE,
    bevel: float = 0.003,
    grain: str = "",
    uv: tuple[float, float] | None = None,
    texel: float = 0.025,
) -> None:
    """An axis-aligned box with chamfered edges.

    Texture u runs along the axis `grain` (default: the longest one). `uv` is the texture coordinate of the corner
    `low`; a random place if None, so that no two boards show the same grain.
    """
    lo, hi = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    first = "xyz".index(grain) if grain else int(np.argmax(hi - lo))
    offset = build.rng.uniform(0, 5, 2) if uv is None else np.asarray(uv)
    # Point (corner, axis): the box's corner, moved inwards along the two axes other than `axis`.
    inward = np.where(_CORNERS, -bevel, bevel)[:, None] * (1 - np.eye(3))
    points = (np.where(_CORNERS, hi, lo)[:, None] + inward).reshape(-1, 3)
    quads, flat = (_QUADS, _FLAT) if bevel > 0 else (_QUADS[:6], _FLAT[:6])
    corners = points[quads]
    a = np.where(flat == first, (flat + 1) % 3, first)
    q = corners - lo + (0.37 * flat[:, None, None] if uv is None else 0.0)
    uv_corners = np.take_along_axis(q, np.stack([a, 3 - a - flat], 1)[:, None], axis=2) + offset
    build.add_quads(corners, uv_corners, material, tint, texel)


_CORNERS = np.array([[(c >> k) & 1 for k in range(3)] for c in range(8)])


def _box_quads() -> tuple[np.ndarray, np.ndarray]:
    """The 6 faces, 12 chamfers and 8 corners of a box as rows of its 24 points, and the axis each mostly faces."""
    quads = []
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        for side in (0, 1):
            ring = [side << axis | va << a | vb << b for va, vb in ((0, 0), (1, 0), (1, 1), (0, 1))]
            quads.append([3 * c + axis for c in ring])
    for axis in range(3):  # Chamfers along `axis`, between the faces of the two other axes.
        a, b = (axis + 1) % 3, (axis + 2) % 3
        for near in (va << a | vb << b for va in (0, 1) for vb in (0, 1)):
            far = near | 1 << axis
            quads.append([3 * near + a, 3 * far + a, 3 * far + b, 3 * near + b])
    quads += [[3 * c, 3 * c + 1, 3 * c + 2, 3 * c + 2] for c in range(8)]
    sample = ((_CORNERS - 0.5)[:, None] * (1 - 0.2 * (1 - np.eye(3)))).reshape(-1, 3)
    flat = []
    for k, quad in enumerate(quads):
        p = sample[quad]
        normal = np.cross(p[2] - p[0], p[3] - p[1])
        if normal @ p.mean(axis=0) < 0:
            quads[k] = [quad[1], quad[0], quad[3], quad[2]]
        flat.append(int(np.argmax(np.abs(normal))))
    return np.array(quads), np.array(flat)


_QUADS, _FLAT = _box_quads()


def smooth(
    build: Builder,
    grids: Sequence[Float[np.ndarray, "t s 3"]],
    material: int,
    tint: Color = WHITE,
    texel: float | tuple[float, float] = 0.03,
    lay: Literal["along", "across", "above"] = "along",
) -> None:
    """Curved charts in one smooth piece.

    Texture coordinates follow the lengths of the middle row and column (`along`: u on s; `across`: u on t), or are
    x and y (`above`).
    """
    points, indices = weld(grids)
    offset = build.rng.uniform(0, 5, 2)
    charts = []
    for grid, index in zip(grids, indices):
        length = [np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in
                  (grid[len(grid) // 2], grid[:, grid.shape[1] // 2])]  # fmt: skip
        uv = grid[..., :2] if lay == "above" else even_st(index.shape) * length
        charts.append(Grid(index, (uv[..., ::-1] if lay == "across" else uv) + offset))
    build.add(points, charts, material, tint, texel)


def revolve(
    build: Builder,
    profile: Sequence[tuple[float, float]],
    material: int,
    tint: Color = WHITE,
    sides: int = 32,
    texel: float = 0.015,
    steps: int = 1,
    lay: Literal["along", "across", "above"] = "along",
) -> None:
    """A solid of revolution about local z. `profile` lists (radius, z) with the solid to its left going up."""
    line = np.asarray(profile, dtype=float)
    at = np.linspace(0, len(line) - 1, (len(line) - 1) * steps + 1)
    r, z = (np.interp(at, np.arange(len(line)), line[:, k]) for k in (0, 1))
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    angle[-1] = 0.0
    grid = np.stack(
        [r[:, None] * np.cos(angle), r[:, None] * np.sin(angle), np.repeat(z[:, None], sides + 1, 1)], -1
    )
    smooth(build, [grid], material, tint, texel, lay)


def tube(
    build: Builder,
    path: Sequence[Sequence[float]] | np.ndarray,
    radius: float | Sequence[float] | np.ndarray,
    material: int,
    tint: Color = WHITE,
    sides: int = 10,
    caps: bool = True,
) -> None:
    """A round rod along a polyline; `radius` may vary from point to point."""
    line = np.asarray(path, dtype=float)
    along = np.gradient(line, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    helper = np.eye(3)[int(np.argmin(np.abs(along).sum(axis=0)))]
    x = np.cross(helper, along)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.cross(along, x)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    angle[-1] = 0.0
    r = np.broadcast_to(radius, len(line))[:, None, None]
    ring = np.cos(angle)[None, :, None] * x[:, None] + np.sin(angle)[None, :, None] * y[:, None]
    grid = line[:, None] + r * ring
    smooth(build, [grid], material, tint, (float(np.max(r)), 0.04), "across")
    if caps:
        for end, flip in ((0, -1), (-1, 1)):
            disc = np.stack([np.repeat(line[end][None], sides + 1, 0), grid[end]])
            smooth(build, [disc[::-flip]], material, tint, 0.05)


def _cube(half: np.ndarray, nodes: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The six faces of a box as grids with the given node positions along each axis, in [-1, 1]."""
    faces = []
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        for side in (-1.0, 1.0):
            sb, sa = np.meshgrid(nodes[b], nodes[a], indexing="ij")
            p = np.empty((*sa.shape, 3))
            p[..., axis], p[..., a], p[..., b] = side, sa, sb
            faces.append((p if side > 0 else p[:, ::-1]) * half)
    return faces


def cushion(
    build: Builder,
    low: Sequence[float],
    high: Sequence[float],
    radius: float,
    material: int,
    tint: Color = WHITE,
    bulge: float = 0.0,
    bulge_axis: int = 2,
    texel: float = 0.025,
    flat_steps: int = 6,
) -> None:
    """A box with round edges, and its two large sides (`bulge_axis`) blown up by `bulge`."""
    lo, hi = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    half = (hi - lo) / 2
    nodes = []
    for k in range(3):
        rim = radius * np.tan(np.radians([45, 33.75, 22.5, 11.25, 0]))
        flat = np.linspace(0, half[k] - radius, flat_steps // 2 + 1)[:-1]
        positive = np.concatenate([flat, half[k] - radius + rim[::-1]]) / half[k]
        nodes.append(np.concatenate([-positive[:0:-1], positive]))
    grids = []
    for p in _cube(half, nodes):
        core = np.clip(p, radius - half, half - radius)
        out = p - core
        q = core + radius * out / np.linalg.norm(out, axis=-1, keepdims=True)
        others = [k for k in range(3) if k != bulge_axis]
        swell = np.prod(np.cos(np.clip(q[..., others] / half[others], -1, 1) * np.pi / 2) ** 0.5, axis=-1)
        q[..., bulge_axis] += bulge * swell * q[..., bulge_axis] / half[bulge_axis]
        grids.append(q + (lo + hi) / 2)
    smooth(build, grids, material, tint, texel)


def pillow(
    build: Builder, size: float, thickness: float, lean: float, material: int, tint: Color, height: float
) -> None:
    """A throw pillow in the local x–z plane, pinched at its corners, leaning back by `lean` degrees about x."""
    n = 17
    t, s = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n), indexing="ij")
    pinch = 1 - 0.07 * (1 - np.abs(s) ** 2) * np.abs(t) ** 3
    pinch_z = 1 - 0.07 * (1 - np.abs(t) ** 2) * np.abs(s) ** 3
    x, z = s * size / 2 * pinch_z, t * size / 2 * pinch
    y = thickness / 2 * ((1 - s**4) * (1 - t**4)) ** 0.6
    c, k = np.cos(np.radians(lean)), np.sin(np.radians(lean))
    grids = []
    for side in (-1, 1):
        p = np.stack([x, side * y * c + z * k, z * c - side * y * k + height], axis=-1)
        grids.append(p if side < 0 else p[:, ::-1])
    smooth(build, grids, material, tint, 0.02)


def sheet(
    build: Builder,
    grid: Float[np.ndarray, "t s 3"],
    material: int,
    tint: Color = WHITE,
    thickness: float = 0.002,
    texel: float = 0.03,
) -> None:
    """A thin curved sheet with a front and a back, `thickness` apart and joined along nothing but air."""
    ds, dt = np.gradient(grid, axis=1), np.gradient(grid, axis=0)
    normal = np.cross(ds, dt)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    smooth(build, [grid + normal * thickness / 2], material, tint, texel)
    smooth(build, [(grid - normal * thickness / 2)[:, ::-1]], material, tint, texel)
