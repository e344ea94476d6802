"""Kernel of the rasteriser that makes surface points of the nearest triangles."""

import numpy as np

from hyjax.util.compiled import compiled


@compiled(
    "void(f8[:,::1], i4[:,::1], f4[:,::1], f8[:,::1], f8[:,::1], i4[:,::1], UniTuple(i8, 2), "
    "f4[:,:,::1], f4[:,:,::1], f4[:,::1], b1[:,::1], f4[:,:,::1])"
)
def surface(
    vertices: np.ndarray,
    triangles: np.ndarray,
    normals: np.ndarray,
    points: np.ndarray,
    rays: np.ndarray,
    faces: np.ndarray,
    rows: tuple[int, int],
    position: np.ndarray,
    normal: np.ndarray,
    depth: np.ndarray,
    hit: np.ndarray,
    barycentric: np.ndarray,
) -> None:
    """Attributes of the nearest triangles at the pixels of some rows, in a perspective view of one piece.

    Args:
        normals: (n, 3), of the vertices.
        faces: changed to -1 where the attributes of a triangle cannot be told.
        rays: direction of the ray through pixel (0, 0), its change by a column and by a row, and its origin.
        position, normal, depth, hit, barycentric: filled, see `GBuffer`.
    """
    e, plane = np.zeros((3, 3)), np.zeros(3)
    a, b, c, last, sign = 0, 0, 0, -1, 1.0
    f0 = f1 = f2 = g0 = g1 = g2 = 0.0
    for row in range(rows[0], rows[1]):
        for column in range(faces.shape[1]):
            face = faces[row, column]
            if face >= 0 and face != last:
                last = face
                a, b, c = triangles[face, 0], triangles[face, 1], triangles[face, 2]
                for i, j, k in ((0, b, c), (1, c, a), (2, a, b)):
                    e[i, 0] = points[j, 1] * points[k, 2] - points[j, 2] * points[k, 1]
                    e[i, 1] = points[j, 2] * points[k, 0] - points[j, 0] * points[k, 2]
                    e[i, 2] = points[j, 0] * points[k, 1] - points[j, 1] * points[k, 0]
                for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
                    plane[i] = (vertices[b, j] - vertices[a, j]) * (vertices[c, k] - vertices[a, k])
                    plane[i] -= (vertices[b, k] - vertices[a, k]) * (vertices[c, j] - vertices[a, j])
            if face >= 0:
                f0 = abs(e[0, 0] * column + (e[0, 1] * row + e[0, 2]))
                f1 = abs(e[1, 0] * column + (e[1, 1] * row + e[1, 2]))
                f2 = abs(e[2, 0] * column + (e[2, 1] * row + e[2, 2]))
                g0, g1, g2 = f0 * points[a, 3], f1 * points[b, 3], f2 * points[c, 3]
            # A triangle that is seen exactly edge-on has no point of its own there.
            hit[row, column] = face >= 0 and g0 + g1 + g2 > 0.0
            if not hit[row, column]:
                faces[row, column] = -1
                depth[row, column] = 0.0
                for k in range(3):
                    position[row, column, k] = normal[row, column, k] = barycentric[row, column, k] = 0.0
                continue
            whole = 1.0 / (g0 + g1 + g2)
            g0, g1, g2 = g0 * whole, g1 * whole, g2 * whole
            z = (f0 * points[a, 2] + f1 * points[b, 2] + f2 * points[c, 2]) * whole
            depth[row, column] = z
            barycentric[row, column, 0], barycentric[row, column, 1], barycentric[row, column, 2] = g0, g1, g2
            n0 = g0 * normals[a, 0] + g1 * normals[b, 0] + g2 * normals[c, 0]
            n1 = g0 * normals[a, 1] + g1 * normals[b, 1] + g2 * normals[c, 1]
            n2 = g0 * normals[a, 2] + g1 * normals[b, 2] + g2 * normals[c, 2]
            d0 = rays[0, 0] + column * rays[1, 0] + row * rays[2, 0]
            d1 = rays[0, 1] + column * rays[1, 1] + row * rays[2, 1]
            d2 = rays[0, 2] + column * rays[1, 2] + row * rays[2, 2]
            # The triangle decides which side is seen. Near a silhouette an interpolated normal may lean a little
            # away from the camera in all honesty; turned round it would be lit from the wrong side.
            away = plane[0] * d0 + plane[1] * d1 + plane[2] * d2 > 0.0
            sign = -1.0 if away != (plane[0] * n0 + plane[1] * n1 + plane[2] * n2 < 0.0) else 1.0
            length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
            sign = sign / max(length, 1e-20) if length > 0.0 else 0.0
            normal[row, column, 0] = n0 * sign
            normal[row, column, 1] = n1 * sign
            normal[row, column, 2] = n2 * sign
            position[row, column, 0] = rays[3, 0] + z * d0
            position[row, column, 1] = rays[3, 1] + z * d1
            position[row, column, 2] = rays[3, 2] + z * d2
