"""Closing the holes of a scanned mesh, so that no light falls through them.

The rim of a hole is cut across at its narrowest notch, again and again, for as long as the cut is short: small
holes close, the spiky rims of large ones become smooth, and an opening wider than `gap` stays one.
"""

import heapq
from collections.abc import Sequence

import numpy as np
import trimesh
from jaxtyping import Float, Int


def close_holes(mesh: trimesh.Trimesh, gap: float) -> trimesh.Trimesh:
    """Mesh with its holes closed as far as no new edge is longer than `gap` metres; its vertices stay.

    The new triangles come last, wound like their surroundings. They are made to throw shadows, not to be looked at:
    where a rim is folded they may lie over each other.
    """
    new = [triangle for rim in rims(mesh.faces) for triangle in _cut_notches(np.asarray(mesh.vertices), rim, gap)]
    if not new:
        return mesh
    faces = np.concatenate([np.asarray(mesh.faces), np.array(new, dtype=mesh.faces.dtype)])
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def rims(faces: Int[np.ndarray, "m 3"]) -> list[list[int]]:
    """Rims of holes: closed walks over vertices along edges that have a triangle on one side only.

    A walk passes no vertex twice; where holes meet in a vertex each has its own. Its direction is that of the
    triangles which are missing.
    """
    edges = np.concatenate([np.asarray(faces, np.int64)[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    count = int(edges.max(initial=0)) + 1
    backward = edges[:, 1] * count + edges[:, 0]
    onward: dict[int, list[int]] = {}
    for end, start in edges[~np.isin(edges[:, 0] * count + edges[:, 1], backward)].tolist():
        onward.setdefault(start, []).append(end)
    found: list[list[int]] = []
    while onward:
        walk = [next(iter(onward))]
        place = {walk[0]: 0}
        while walk:
            if walk[-1] not in onward:  # a dead end, as where triangles are wound against each other
                del place[walk.pop()]
                continue
            ends = onward[walk[-1]]
            vertex = ends.pop()
            if not ends:
                del onward[walk[-1]]
            if vertex in place:
                found.append(walk[place[vertex] :])
                for passed in walk[place[vertex] + 1 :]:
                    del place[passed]
                del walk[place[vertex] + 1 :]
            else:
                place[vertex] = len(walk)
                walk.append(vertex)
    return [rim for rim in found if len(rim) > 2]


def _cut_notches(vertices: Float[np.ndarray, "n 3"], rim: Sequence[int], gap: float) -> list[tuple[int, int, int]]:
    """Triangles between neighbours on a rim, the shortest cut first."""
    count, points = len(rim), vertices[list(rim)]
    before, after = [(k - 1) % count for k in range(count)], [(k + 1) % count for k in range(count)]

    def cut(k: int) -> float:
        return float(np.linalg.norm(points[before[k]] - points[after[k]]))

    lengths = [cut(k) for k in range(count)]
    queue = [(length, k) for k, length in enumerate(lengths)]
    heapq.heapify(queue)
    made: list[tuple[int, int, int]] = []
    while queue and len(made) < count - 2:
        length, k = heapq.heappop(queue)
        if length != lengths[k]:
            continue  # cut off, or with another neighbour by now
        if length > gap:
            break
        left, right = before[k], after[k]
        made.append((rim[left], rim[k], rim[right]))
        lengths[k], after[left], before[right] = np.nan, right, left
        for end in (left, right):
            lengths[end] = cut(end)
            heapq.heappush(queue, (lengths[end], end))
    return made
