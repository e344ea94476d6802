"""Kernels of the rasteriser: vertices projected, triangles drawn into a buffer of the nearest.

Homogeneous rasterisation (Olano and Greer, *Triangle scan conversion using 2D homogeneous coordinates*, 1997). An
edge's function is the cross product of its two projected ends; in the neighbour it is exactly the negated one, so
that no pixel lies outside both. Nothing is clipped: it is the edge functions that say what lies behind the eye.

A buffer holds keys, the larger the nearer: the inverse of the distance along the ray, or, where rays are parallel,
the negated distance. Either is affine in the pixel. Keys are as of a direction whose w is 1, see `project`.

Everything lies in this file, as Numba's cache looks at no other when it decides whether to compile anew.
"""

import numpy as np

from hyjax.util.compiled import compiled

FRONT_SHARE = 1e-9
"""Share of a vertex' distance that it must lie in front of the eye's plane to be divided by that."""
FRONT_FLAG = 64
NARROW_COLUMNS = 6
"""Columns up to which a row of a triangle is tested pixel by pixel."""


@compiled()
def _local(vertex: np.ndarray, view: np.ndarray) -> tuple[float, float, float]:
    """Coordinates of a vertex along a view's axes."""
    dx, dy, dz = vertex[0] - view[3, 0], vertex[1] - view[3, 1], vertex[2] - view[3, 2]
    x = view[0, 0] * dx + view[0, 1] * dy + view[0, 2] * dz
    y = view[1, 0] * dx + view[1, 1] * dy + view[1, 2] * dz
    z = view[2, 0] * dx + view[2, 1] * dy + view[2, 2] * dz
    return x, y, z


@compiled()
def _place(local: tuple[float, float, float], piece: np.ndarray, parallel: bool, point: np.ndarray) -> None:
    """Homogeneous column, row and w of a local point, and its key. In front of the eye w is 1."""
    x, y, z = local[0], local[1], 1.0 if parallel else local[2]
    column = piece[0, 0] * x + piece[0, 1] * y + piece[0, 2] * z
    row = piece[1, 0] * x + piece[1, 1] * y + piece[1, 2] * z
    w = piece[2, 0] * x + piece[2, 1] * y + piece[2, 2] * z
    if w > FRONT_SHARE * (abs(x) + abs(y) + abs(z)):
        scale = 1.0 / w
        point[0], point[1], point[2] = column * scale, row * scale, 1.0
        point[3] = -local[2] if parallel else scale
    else:
        point[0], point[1], point[2], point[3] = column, row, min(w, 0.0), 1.0


@compiled("void(f8[:,::1], f8[:,::1], f8[:,:,::1], b1, f8[:,::1], u1[::1], i8, i8)")
def project(
    vertices: np.ndarray,
    view: np.ndarray,
    pieces: np.ndarray,
    parallel: bool,
    points: np.ndarray,
    sides: np.ndarray,
    first: int,
    last: int,
) -> None:
    """Vertices from `first` to `last`, as a view has them.

    Args:
        vertices: (n, 3), world.
        pieces: (p, 3, 3), from the view's axes to homogeneous column, row and w, for each combination of signs of
            the first axes: one, four (x, y) or eight (x, y, z). Bits of a piece's number are set for minus.
        parallel: whether rays are; pieces then act on (x, y, 1).
        points: (n, 4), filled: homogeneous coordinates and key, in the vertex' own piece.
        sides: filled: bits 0–2, whether x, y, z may be negative; bits 3–5, whether they may be positive; bit 6,
            whether the vertex lies in front of the eye.
    """
    mask = len(pieces) - 1
    for i in range(first, last):
        local = _local(vertices[i], view)
        x, y, z = local
        side = 0
        if mask:
            least = FRONT_SHARE * (abs(x) + abs(y) + abs(z))
            side = (x < least) | (y < least) << 1 | (z < least) << 2
            side |= (x > -least) << 3 | (y > -least) << 4 | (z > -least) << 5
        _place(local, pieces[side & mask], parallel, points[i])
        sides[i] = side | FRONT_FLAG if points[i, 2] == 1.0 else side


@compiled()
def _bounds(corner: np.ndarray, axis: int) -> tuple[float, float]:
    """Least and largest coordinate of the part of a triangle that lies in front of the eye."""
    low, high = np.inf, -np.inf
    for i in range(3):
        j = (i + 1) % 3
        if corner[i, 2] == 1.0:
            low, high = min(low, corner[i, axis]), max(high, corner[i, axis])
        if (corner[i, 2] == 1.0) != (
            corner[j, 2] == 1.0
        ):  # To infinity, towards where this edge meets the eye's plane
            front, back = (i, j) if corner[i, 2] == 1.0 else (j, i)
            one, other = -corner[front, axis] * corner[back, 2], corner[back, axis]
            least = 1e-6 * (abs(one) + abs(other))
            high = np.inf if one + other >= -least else high
            low = -np.inf if one + other <= least else low
    return low, high


@compiled()
def _draw_triangle(
    corner: np.ndarray,
    number: int,
    spans: np.ndarray,
    limit: np.ndarray,
    buffers: tuple[np.ndarray, np.ndarray],
) -> None:
    """One triangle, given by its three points, see `draw`."""
    keys, faces = buffers
    x0, y0, w0, k0 = corner[0, 0], corner[0, 1], corner[0, 2], corner[0, 3]
    x1, y1, w1, k1 = corner[1, 0], corner[1, 1], corner[1, 2], corner[1, 3]
    x2, y2, w2, k2 = corner[2, 0], corner[2, 1], corner[2, 2], corner[2, 3]
    front = w0 + w1 + w2 == 3.0
    if front:
        left, right, top, bottom = min(x0, x1, x2), max(x0, x1, x2), min(y0, y1, y2), max(y0, y1, y2)
    else:
        left, right = _bounds(corner, 0)
        top, bottom = _bounds(corner, 1)
    height, width = keys.shape
    if not (left <= width - 1 and right >= 0.0 and top <= height - 1 and bottom >= 0.0):
        return
    start, stop = int(np.ceil(max(left, 0.0))), int(np.floor(min(right, width - 1.0)))
    begin, end = int(np.ceil(max(top, 0.0))), int(np.floor(min(bottom, height - 1.0)))
    if start > stop or begin > end:
        return
    a0, b0, c0 = y1 * w2 - w1 * y2, w1 * x2 - x1 * w2, x1 * y2 - y1 * x2
    a1, b1, c1 = y2 * w0 - w2 * y0, w2 * x0 - x2 * w0, x2 * y0 - y2 * x0
    a2, b2, c2 = y0 * w1 - w0 * y1, w0 * x1 - x0 * w1, x0 * y1 - y0 * x1
    area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0) if front else x0 * a0 + y0 * b0 + w0 * c0
    if area == 0.0 or not np.isfinite(area):
        return
    if area < 0.0:
        a0, b0, c0, a1, b1, c1, a2, b2, c2 = -a0, -b0, -c0, -a1, -b1, -c1, -a2, -b2, -c2
        area = -area
    # The key is known at a corner in front, and its slopes.
    across, down, least, most = 0.0, 0.0, -np.inf, np.inf
    x, y, key = x0, y0, k0
    if front:
        across, down = (a1 * (k1 - k0) + a2 * (k2 - k0)) / area, (b1 * (k1 - k0) + b2 * (k2 - k0)) / area
        least, most = min(k0, k1, k2), max(k0, k1, k2)
    else:
        across, down = (a0 * k0 + a1 * k1 + a2 * k2) / area, (b0 * k0 + b1 * k1 + b2 * k2) / area
        for i in range(3):
            if corner[i, 2] == 1.0:
                x, y, key = corner[i, 0], corner[i, 1], corner[i, 3]
    named = len(faces) > 0
    i0, i1, i2 = 0.0, 0.0, 0.0  # where an edge crosses a row is asked only of edges that do so steeply enough
    if stop - start > NARROW_COLUMNS:
        i0 = 1.0 / a0 if abs(a0) > FRONT_SHARE else 0.0
        i1 = 1.0 / a1 if abs(a1) > FRONT_SHARE else 0.0
        i2 = 1.0 / a2 if abs(a2) > FRONT_SHARE else 0.0
    for row in range(begin, end + 1):
        f0, f1, f2 = b0 * row + c0, b1 * row + c1, b2 * row + c2
        low, high = max(start, spans[0, row]), min(stop, spans[1, row])
        if high - low > NARROW_COLUMNS:
            for a, inverse, f in ((a0, i0, f0), (a1, i1, f1), (a2, i2, f2)):
                if inverse != 0.0:
                    crossing = min(max(-f * inverse, -2.0), width + 1.0)
                    if a > 0.0:
                        low = max(low, int(crossing))
                    else:
                        high = min(high, int(crossing) + 1)
        # An edge's function runs one way along a row, rounded as it is: between two pixels inside all are inside.
        while low <= high and not (a0 * low + f0 >= 0.0 and a1 * low + f1 >= 0.0 and a2 * low + f2 >= 0.0):
            low += 1
        while low < high and not (a0 * high + f0 >= 0.0 and a1 * high + f1 >= 0.0 and a2 * high + f2 >= 0.0):
            high -= 1
        beside = key + down * (row - y)
        for column in range(low, high + 1):
            value = np.float32(min(max(beside + across * (column - x), least), most))
            if value > keys[row, column] and (named or value < limit[row, column]):
                keys[row, column] = value
                if named:
                    faces[row, column] = number


@compiled("i8(i4[:,::1], f8[:,::1], u1[::1], i8, i8, i8, UniTuple(i8, 2), i4[::1])")
def select(
    triangles: np.ndarray,
    points: np.ndarray,
    sides: np.ndarray,
    mask: int,
    first: int,
    last: int,
    shape: tuple[int, int],
    chosen: np.ndarray,
) -> int:
    """Triangles from `first` to `last` whose boxes hold a pixel's centre, or that may lie in several pieces.

    Args:
        triangles: (m, 3), numbers of vertices.
        chosen: (m,), whose places from `first` on are filled with their numbers.

    Returns:
        How many they are.
    """
    bottom, right = shape[0] - 1.0, shape[1] - 1.0
    count = 0
    for number in range(first, last):
        a, b, c = triangles[number, 0], triangles[number, 1], triangles[number, 2]
        side = sides[a] | sides[b] | sides[c]
        several = side & mask & (side >> 3)
        if not several:
            if not side & FRONT_FLAG:
                continue
            if sides[a] & sides[b] & sides[c] & FRONT_FLAG:
                x0, x1, x2 = points[a, 0], points[b, 0], points[c, 0]
                y0, y1, y2 = points[a, 1], points[b, 1], points[c, 1]
                low, high = min(x0, x1, x2), max(x0, x1, x2)
                if high < 0.0 or low > right or np.floor(high) < low:
                    continue
                low, high = min(y0, y1, y2), max(y0, y1, y2)
                if high < 0.0 or low > bottom or np.floor(high) < low:
                    continue
        chosen[first + count] = number
        count += 1
    return count


@compiled(
    "void(i4[::1], f8[:,::1], i4[:,::1], f8[:,::1], f8[:,:,::1], b1, f8[:,::1], u1[::1], i4[:,:,::1], "
    "f4[:,::1], Tuple((f4[:,::1], i4[:,::1])))"
)
def draw(
    chosen: np.ndarray,
    vertices: np.ndarray,
    triangles: np.ndarray,
    view: np.ndarray,
    pieces: np.ndarray,
    parallel: bool,
    points: np.ndarray,
    sides: np.ndarray,
    spans: np.ndarray,
    limit: np.ndarray,
    buffers: tuple[np.ndarray, np.ndarray],
) -> None:
    """Triangles into buffers; where two are equally near, the one that comes first.

    Args:
        triangles: (m, 3), numbers of vertices.
        spans: (p, 2, h), first and last column of each piece in each row.
        limit: (h, w), keys must be smaller; not looked at where triangles' numbers are asked for.
        buffers: (h, w) of keys, and of the nearest triangles' numbers; the latter empty if they are not asked for.
    """
    mask = len(pieces) - 1
    corner = np.empty((3, 4))
    for number in chosen:
        side = 0
        for i in range(3):
            vertex = triangles[number, i]
            side |= sides[vertex]
            for k in range(4):
                corner[i, k] = points[vertex, k]
        minus, plus = side & mask, (side >> 3) & mask
        several = minus & plus
        for piece in range(0 if several else minus, minus + 1):
            if several:
                if piece & ~minus or mask & ~(piece | plus):
                    continue
                for i in range(3):
                    _place(_local(vertices[triangles[number, i]], view), pieces[piece], parallel, corner[i])
            _draw_triangle(corner, number, spans[piece], limit, buffers)


@compiled("void(f4[:,::1], f4[:,::1], f4[:,::1], b1)")
def distances(keys: np.ndarray, norm: np.ndarray, limit: np.ndarray, parallel: bool) -> None:
    """Keys turned into distances, infinite where nothing is hit, −∞ where the limit lets nothing be.

    Args:
        keys: (h, w), changed in place.
        norm: (h, w), length of the direction whose w is 1.
    """
    for row in range(keys.shape[0]):
        for column in range(keys.shape[1]):
            if limit[row, column] == -np.inf:
                keys[row, column] = -np.inf
            elif parallel:
                keys[row, column] = -keys[row, column]
            elif keys[row, column] > 0.0:
                keys[row, column] = norm[row, column] / keys[row, column]
            else:
                keys[row, column] = np.inf


@compiled("void(f4[:,:,::1], i4[:,:,::1], i8, i8)")
def merge(keys: np.ndarray, faces: np.ndarray, first: int, last: int) -> None:
    """The nearest of several buffers in rows from `first` to `last`, into the first one; −1 where none has any.

    Args:
        keys, faces: (b, h, w), see `draw`; of views whose rays spread out.
    """
    for row in range(first, last):
        for column in range(keys.shape[2]):
            best, face = np.float32(0.0), np.int32(-1)
            for buffer in range(len(keys)):
                if keys[buffer, row, column] > best:
                    best, face = keys[buffer, row, column], faces[buffer, row, column]
            faces[0, row, column] = face
