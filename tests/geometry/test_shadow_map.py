"""The squares of directions that shadow maps are."""

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from hyjax import AmbientLight, Aperture, DirectionalLight, GBuffer, PointLight, RectLight, SkyLight, visibility
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.light.kinds import Light
from hyjax.light.shadow_map import map_coordinates, map_rays

unit_range = st.floats(-0.999, 0.999)


@given(st.sampled_from(["octahedral", "hemisphere", "perspective", "orthographic"]), unit_range, unit_range)
def test_rays_and_coordinates_are_inverse(projection: str, u: float, v: float) -> None:
    origin, direction = (np.array(vector) for vector in map_rays(jnp.array(u), jnp.array(v), projection))
    for distance in (0.3, 7.0):
        got = map_coordinates(tuple(map(jnp.asarray, origin + distance * direction)), projection)
        np.testing.assert_allclose(got, [u, v, distance], atol=3e-6 * max(1.0, distance))


@given(st.sampled_from(["octahedral", "hemisphere"]), st.integers(0, 2**31))
def test_every_direction_has_its_place(projection: str, seed: int) -> None:
    way = np.random.default_rng(seed).normal(size=(3, 64))
    way = (way / np.linalg.norm(way, axis=0)).astype(np.float32)
    if projection == "hemisphere":
        way[2] = np.abs(way[2])
    u, v, distance = map_coordinates(tuple(map(jnp.asarray, way)), projection)
    assert np.all(np.abs(u) <= 1 + 1e-6) and np.all(np.abs(v) <= 1 + 1e-6)
    np.testing.assert_allclose(distance, 1.0, rtol=1e-5)
    np.testing.assert_allclose(map_rays(u, v, projection)[1], way, atol=1e-5)


@pytest.mark.parametrize("projection", ["octahedral", "hemisphere", "perspective", "orthographic"])
def test_the_gutter_continues_the_map(projection: str) -> None:
    """No step from one texel to the next is much longer or shorter than those inside, corners included."""
    size = 16
    ticks = (2.0 * np.arange(-1, size + 1) + 1.0) / size - 1.0
    u, v = (jnp.asarray(a) for a in np.meshgrid(ticks, ticks))
    rays = np.concatenate([np.stack(part, axis=-1) for part in map_rays(u, v, projection)], axis=-1)
    longest = [np.linalg.norm(np.diff(rays[1:-1, 1:-1], axis=axis), axis=-1).max() for axis in (0, 1)]
    everywhere = [np.linalg.norm(np.diff(rays, axis=axis), axis=-1).max() for axis in (0, 1)]
    assert max(everywhere) < 1.3 * max(longest)
    # Standing still would mean that the gutter folds back onto the texels beside it.
    for axis in (0, 1):
        steps = np.linalg.norm(np.diff(rays, axis=axis), axis=-1)
        assert steps.min() > 0.2 * max(longest)
    for edge in (1 - 1e-5, -1 + 1e-5):
        for a, b in (((edge, 0.3), (edge * 1.00002, 0.3)), ((-0.6, edge), (-0.6, edge * 1.00002))):
            inside, outside = (np.array(map_rays(jnp.array(p[0]), jnp.array(p[1]), projection)) for p in (a, b))
            np.testing.assert_allclose(inside, outside, atol=1e-4)


def test_before_the_opening_nothing_is_lit_through_it() -> None:
    """A floor that runs under a window, seen on both sides of it: the sun comes in on one alone."""
    floor = trimesh.Trimesh([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    vec = functools.partial(jnp.array, dtype=jnp.float32)
    window = Aperture(vec([0.0, 0, 1]), vec([0.0, 1, 0]), vec([0.0, 0, 0.5]))
    sun = DirectionalLight(vec([1.0, 0, -1]), vec(500.0), vec([1.0, 1, 1]), aperture=window)
    (shadow_map,) = cast_shadow_maps(RayCaster(floor), [sun], 0.25)
    x = vec([-1.0, -0.5, 0.7, 1.0, 1.3, 2.0])
    position = jnp.stack([x, 0 * x, 0 * x], axis=-1)[None]
    points = GBuffer(position, jnp.zeros_like(position).at[..., 2].set(1.0), x[None], jnp.ones((1, 6), bool))
    np.testing.assert_array_equal(np.asarray(visibility(points, sun, shadow_map))[0], [0, 0, 1, 1, 1, 0])


def test_within_its_clearance_a_lamp_throws_no_shadow() -> None:
    shade = trimesh.creation.icosphere(subdivisions=2, radius=0.2)
    vec = functools.partial(jnp.array, dtype=jnp.float32)
    point = GBuffer(vec([[[0.0, 0, -1]]]), vec([[[0.0, 0, 1]]]), vec([[1.0]]), jnp.ones((1, 1), bool))
    for clearance, lit in ((0.0, 0.0), (0.3, 1.0)):
        lamp = PointLight(vec([0.0, 0, 0]), vec(100.0), vec([1.0, 1, 1]), clearance=clearance)
        (shadow_map,) = cast_shadow_maps(RayCaster(shade), [lamp], 0.1)
        assert np.asarray(visibility(point, lamp, shadow_map)).item() == lit


@pytest.mark.parametrize("most", [4, 8])
@pytest.mark.parametrize("kind", ["window", "sky"])
def test_thinned_views_are_spread_as_all_are(kind: str, most: int) -> None:
    """A window's are not on one line, a sky's not on one side."""
    window = RectLight(np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), 1.0, np.ones(3)).shadow_views()
    sky = SkyLight(np.array([0.0, 0.0, 1.0]), 1.0, np.ones(3)).shadow_views()
    every = window.origins if kind == "window" else sky.directions
    some = window.thinned(most).origins if kind == "window" else sky.thinned(most).directions
    assert len(some) == most and len(np.unique(some, axis=0)) == most
    assert np.abs(some.mean(axis=0) - every.mean(axis=0)).max() < 0.25
    assert (some.std(axis=0)[:2] > 0.5 * every.std(axis=0)[:2]).all()
    assert len(window.thinned(99).origins) == window.count


def test_kept_maps_are_found_by_mesh_and_light(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[int] = []
    monkeypatch.setattr(RayCaster, "distances", counted(RayCaster.distances, drawn))
    box = trimesh.creation.box((4.0, 4.0, 4.0))
    window = Aperture(jnp.array([0.0, 0, 1]), jnp.array([0.0, 1, 0]), jnp.array([0.0, 0, 0.5]))
    lights: list[Light] = [
        PointLight(jnp.zeros(3), 9.0, jnp.ones(3)),
        PointLight(jnp.zeros(3), 9.0, jnp.ones(3), clearance=0.5),
        PointLight(jnp.ones(3), 9.0, jnp.ones(3)),
        DirectionalLight(jnp.array([1.0, 0, -1]), 9.0, jnp.ones(3)),
        DirectionalLight(jnp.array([1.0, 0, -1]), 9.0, jnp.ones(3), aperture=window),
        AmbientLight(9.0, jnp.ones(3)),
    ]
    anew = cast_shadow_maps(RayCaster(box), lights, 0.05, 0.03)
    made = cast_shadow_maps(RayCaster(box), lights, 0.05, 0.03, folder=tmp_path)
    drawn.clear()
    found = cast_shadow_maps(RayCaster(box), lights, 0.05, 0.03, folder=tmp_path)
    assert not drawn and len(list(tmp_path.iterdir())) == 5  # of all but the ambient light
    for one, other, third in zip(jax.tree.leaves(anew), jax.tree.leaves(made), jax.tree.leaves(found), strict=True):
        np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(one, third)
    cast_shadow_maps(RayCaster(box), [dataclasses.replace(lights[0], luminous_flux=1.0)], 0.05, folder=tmp_path)
    assert not drawn  # another strength throws the same shadows
    cast_shadow_maps(RayCaster(trimesh.creation.box((4.0, 4.0, 5.0))), lights[:1], 0.05, folder=tmp_path)
    assert drawn


def counted(function: Callable[..., Any], calls: list[int]) -> Callable[..., Any]:
    def call(*arguments: Any) -> Any:
        calls.append(1)
        return function(*arguments)

    return call
