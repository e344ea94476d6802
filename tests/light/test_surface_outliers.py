"""Outliers of light on a scan's vertices: dots go, slopes and corners stay."""

import numpy as np
import trimesh

from hyjax.light.surface_outliers import without_outliers


def sheet() -> trimesh.Trimesh:
    mesh = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    return mesh.subdivide_to_size(0.15)


def test_a_dot_is_brought_to_its_surroundings_and_a_slope_stays() -> None:
    mesh = sheet()
    slope = np.repeat(1.0 + mesh.vertices[:, :1], 3, axis=1).astype(np.float32)
    np.testing.assert_allclose(without_outliers(slope, mesh.faces), slope, rtol=1e-6)
    middle = int(np.argmin(np.linalg.norm(mesh.vertices - 0.5, axis=1)))
    dotted = slope.copy()
    dotted[middle] = 20.0
    mended = np.asarray(without_outliers(dotted, mesh.faces))
    assert mended[middle].max() < 2.6
    np.testing.assert_allclose(np.delete(mended, middle, axis=0), np.delete(slope, middle, axis=0), rtol=1e-6)


def test_the_light_of_a_corner_stays() -> None:
    mesh = trimesh.creation.box((1, 1, 1)).subdivide_to_size(0.15)
    corner = np.exp(-2.0 * np.linalg.norm(mesh.vertices - 0.5, axis=1))[:, None].astype(np.float32)
    np.testing.assert_allclose(without_outliers(corner, mesh.faces), corner, rtol=0.15)


def test_a_lone_triangle_keeps_its_values() -> None:
    values = np.array([[1.0], [2.0], [50.0]], np.float32)
    np.testing.assert_array_equal(without_outliers(values, np.array([[0, 1, 2]])), values)
