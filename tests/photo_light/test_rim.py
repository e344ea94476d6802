"""Rim of a scan: where it is, and that its light is held to what is known nearby."""

import numpy as np
import trimesh

from hyjax.photo_light.rim import RIM_WIDTH, SLACK, held_at_rim, rim_of


def floor() -> trimesh.Trimesh:
    mesh = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    return mesh.subdivide_to_size(0.05)


def test_the_rim_is_at_open_edges_alone() -> None:
    mesh = floor()
    inside = np.abs(mesh.vertices[:, :2] - 0.5).max(axis=1)
    np.testing.assert_array_equal(rim_of(mesh.vertices, mesh.faces), inside >= 0.5 - RIM_WIDTH)
    closed = trimesh.creation.box((1, 1, 1))
    assert not rim_of(closed.vertices, closed.faces).any()


def test_light_at_the_rim_is_held_and_all_other_light_stays() -> None:
    mesh = floor()
    rim = rim_of(mesh.vertices, mesh.faces)
    light = np.where(rim[:, None], 9.0, 1.0 + mesh.vertices[:, :1]) * np.ones(3)
    held = held_at_rim(light, mesh.vertices, mesh.faces)
    np.testing.assert_array_equal(held[~rim], light[~rim])
    assert held[rim].max() < 2.0 * np.exp(SLACK) and held[rim].min() > 0.9


def test_a_strip_that_is_all_rim_keeps_its_light() -> None:
    strip = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 0.05, 0]], [[0, 1, 2]], process=False)
    light = np.array([[1.0], [5.0], [0.1]])
    np.testing.assert_array_equal(held_at_rim(light, strip.vertices, strip.faces), light)
