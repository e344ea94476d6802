"""Holes of scanned meshes, and the shadows of scans with holes."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from hyjax import GBuffer, PointLight, visibility
from hyjax.geometry.hole_closing import close_holes, rims
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.shadow_caster import cast_shadow_maps


def plane(cells: int = 20, height: float = 1.0) -> trimesh.Trimesh:
    """A square of 2 m, cut into triangles."""
    ticks = np.linspace(-1, 1, cells + 1)
    x, y = (grid.reshape(-1) for grid in np.meshgrid(ticks, ticks))
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).reshape(-1)
    a, b, c, d = corner, corner + 1, corner + cells + 2, corner + cells + 1
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return trimesh.Trimesh(np.stack([x, y, 0 * x + height], axis=1), faces, process=False)


def torn(mesh: trimesh.Trimesh, radius: float) -> trimesh.Trimesh:
    kept = np.linalg.norm(mesh.triangles_center[:, :2], axis=1) > radius
    return trimesh.Trimesh(mesh.vertices, mesh.faces[kept], process=False)


@given(st.integers(0, 3), st.floats(0.01, 9.0))
def test_a_closed_mesh_is_unchanged(subdivisions: int, gap: float) -> None:
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    assert rims(sphere.faces) == []
    assert close_holes(sphere, gap) is sphere


@given(st.sets(st.integers(0, 319), min_size=1, max_size=40))
def test_every_hole_of_a_ball_closes(missing: set[int]) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    faces = np.delete(ball.faces, sorted(missing), axis=0)
    closed = close_holes(trimesh.Trimesh(ball.vertices, faces, process=False), 9.0)
    np.testing.assert_array_equal(closed.faces[: len(faces)], faces)
    assert rims(closed.faces) == []


def test_wide_openings_stay() -> None:
    hole = torn(plane(), 0.4)
    assert max(map(len, rims(close_holes(hole, 0.3).faces))) > 3
    inner = [rim for rim in rims(close_holes(hole, 1.0).faces) if np.abs(hole.vertices[rim]).max() < 0.9]
    assert inner == []


def test_a_torn_plane_throws_the_shadow_of_the_whole() -> None:
    light = PointLight(jnp.array([0.0, 0, 2]), jnp.float32(800), jnp.ones(3))
    x, y = np.meshgrid(*[np.linspace(-3, 3, 61) + 0.013] * 2)
    position = np.stack([x, y, 0 * x], axis=-1)
    normal = np.broadcast_to([0.0, 0.0, 1.0], position.shape)
    floor = GBuffer(*(jnp.asarray(a, jnp.float32) for a in (position, normal, 1 + 0 * x)), jnp.ones(x.shape, bool))

    def lit(mesh: trimesh.Trimesh) -> np.ndarray:
        return np.asarray(visibility(floor, light, cast_shadow_maps(RayCaster(mesh), [light], 0.25)[0]))

    whole, hole = plane(), torn(plane(), 0.2)
    assert np.abs(lit(hole) - lit(whole)).max() == 1.0
    np.testing.assert_array_equal(lit(close_holes(hole, 0.5)), lit(whole))


def test_what_is_nearer_than_the_slack_throws_no_shadow() -> None:
    """A surface 2 cm off the one that is lit, as two fusions of one wall are; and one 20 cm off."""
    light = PointLight(jnp.array([0.0, 0, 2]), jnp.float32(800), jnp.ones(3))
    position = jnp.array([[[0.1, 0.2, 0.0]]])
    spot = GBuffer(position, jnp.array([[[0.0, 0, 1]]]), jnp.ones((1, 1)), jnp.ones((1, 1), bool))
    for height, slack, expected in ((0.02, None, 0.0), (0.02, 0.03, 1.0), (0.2, 0.03, 0.0)):
        (shadow_map,) = cast_shadow_maps(RayCaster(plane(height=height)), [light], 1.0, slack)
        assert shadow_map is not None and (shadow_map.slack is None) == (slack is None)
        assert float(visibility(spot, light, shadow_map)[0, 0]) == expected
        bare = dataclasses.replace(shadow_map, slack=None)
        assert float(visibility(spot, light, bare)[0, 0]) == 0.0
