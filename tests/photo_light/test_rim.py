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
    held = held_at_rim(light, mesh.vertices, mesh.vertex_normals, mesh.faces)
    np.testing.assert_array_equal(held[~rim], light[~rim])
    assert held[rim].max() < 2.0 * np.exp(SLACK) and held[rim].min() > 0.9


def test_a_strip_that_is_all_rim_keeps_its_light() -> None:
    strip = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 0.05, 0]], [[0, 1, 2]], process=False)
    light = np.array([[1.0], [5.0], [0.1]])
    np.testing.assert_array_equal(held_at_rim(light, strip.vertices, strip.vertex_normals, strip.faces), light)


def test_a_surface_that_faces_elsewhere_holds_no_light() -> None:
    """A bright wall stands at the dark floor's rim, nearer than what else there is of the floor."""
    ground, wall = floor(), floor()
    wall.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [0, 1, 0], [1, 0, 0]))
    wall.apply_translation([0.02, 0, -0.1 - wall.bounds[0, 2]])
    vertices, normals = (
        np.concatenate([ground.vertices, wall.vertices]),
        np.repeat([[0.0, 0, 1], [-1.0, 0, 0]], len(ground.vertices), 0),
    )
    faces = np.concatenate([ground.faces, wall.faces + len(ground.vertices)])
    of_floor = np.arange(len(vertices)) < len(ground.vertices)
    rim = rim_of(vertices, faces)
    light = np.where(of_floor[:, None], np.where(rim[:, None], 9.0, 1.0), 20.0)
    held = held_at_rim(light, vertices, normals, faces)
    assert held[rim & of_floor].max() < 1.0 * np.exp(SLACK) + 1e-9
