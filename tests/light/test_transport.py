"""Light transport: a furnace, linearity, gradients, and where rays of a closed room end."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.transport_rays import CELLS, enclose, trace, wall_axes
from hyjax.light.kinds import AmbientLight, Aperture, PointLight
from hyjax.light.photo_light import PhotoLight, bounced_light, interpolate
from hyjax.light.transport import Transport, bounce, gather, send

UP = np.array([0.0, 0.0, 1.0])


def room(turn: float = 0.0) -> trimesh.Trimesh:
    """A box of 4 × 3 × 2.5 m seen from inside, with vertices every half metre."""
    mesh = trimesh.creation.box((4.0, 3.0, 2.5))
    mesh = mesh.subdivide_to_size(0.8)
    mesh.invert()
    mesh.apply_transform(trimesh.transformations.rotation_matrix(turn, UP))
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)


def transport_of(mesh: trimesh.Trimesh, openings: tuple[Aperture, ...] = (), rays: int = 64) -> Transport:
    caster = RayCaster(mesh)
    hits, position, normal = trace(caster, enclose(caster, UP), openings, rays=rays)
    place, facing = (jnp.asarray(a, jnp.float32) for a in (position, normal))
    return Transport(jnp.asarray(hits), jnp.asarray(mesh.faces, jnp.int32), place, facing, len(mesh.vertices))


def test_walls_give_the_axes_however_a_room_is_turned() -> None:
    axes = wall_axes(room(0.3), UP)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(axes[2], UP)
    np.testing.assert_allclose(np.abs(axes[:2] @ [np.cos(0.3), np.sin(0.3), 0.0]).max(), 1.0, atol=1e-6)


@pytest.fixture(scope="module")
def closed() -> Transport:
    return transport_of(room())


@settings(deadline=None, max_examples=20)
@given(st.floats(0.0, 0.95), st.integers(1, 6))
def test_a_furnace_glows_evenly(closed: Transport, albedo: float, bounces: int) -> None:
    """In a closed room of one albedo under even light each bounce is the one before times the albedo."""
    points = closed.position.shape[0]
    found = bounce(closed, jnp.full((points, 3), albedo), jnp.ones((points, 3)), bounces)
    expected = sum(albedo**k for k in range(1, bounces + 1))
    inside = np.asarray(found)[: closed.vertices]
    np.testing.assert_allclose(np.median(inside), expected, rtol=1e-4, atol=1e-6)


def test_bounces_of_two_lights_add_up(closed: Transport) -> None:
    rng = np.random.default_rng(0)
    points = closed.position.shape[0]
    albedo = jnp.asarray(rng.uniform(0.1, 0.9, (points, 3)), jnp.float32)
    a, b = (jnp.asarray(rng.random((points, 3)), jnp.float32) for _ in range(2))
    together = bounce(closed, albedo, jnp.concatenate([a, b], axis=-1))
    np.testing.assert_allclose(together[:, :3], bounce(closed, albedo, a), rtol=1e-5)
    np.testing.assert_allclose(
        together[:, :3] + together[:, 3:], bounce(closed, albedo, a + b), rtol=1e-4, atol=1e-6
    )


def test_rays_of_a_closed_room_end_on_its_walls(closed: Transport) -> None:
    vertices = np.asarray(closed.hits)[:, : closed.vertices]
    assert (vertices < len(closed.faces)).mean() > 0.97  # rays along edges may slip out


@pytest.mark.parametrize("turn", [0.0, 0.3, 1.2])
def test_the_box_round_a_scan_lies_along_its_walls(turn: float) -> None:
    box = enclose(RayCaster(room(turn)), UP)
    np.testing.assert_allclose(sorted(box.high - box.low), [2.54, 3.04, 4.04], atol=0.03)
    centres, normals = box.patches()
    assert len(centres) == 6 * CELLS**2
    middle = (box.low + box.high) / 2 @ box.axes
    assert (np.einsum("nk,nk->n", middle - centres, normals) > 0).all()


def test_a_flat_scan_has_a_box_that_stands_off_it() -> None:
    """Closer, the light of the box could take the form of any paint."""
    box = enclose(RayCaster(trimesh.creation.box((1.2, 0.6, 0.1))), UP)
    low, high = np.sort([box.low @ box.axes, box.high @ box.axes], axis=0)
    np.testing.assert_allclose([low, high], [[-0.62, -0.5, -0.07], [0.62, 0.5, 0.93]], atol=1e-6)


@given(st.integers(0, 2**32 - 1))
def test_rays_leave_the_box_on_the_patch_that_is_found(seed: int) -> None:
    rng, axis = np.random.default_rng(seed), np.eye(3)
    box = enclose(RayCaster(room(0.4)), UP)
    inside = (box.low + rng.random((40, 3)) * (box.high - box.low)) @ box.axes
    directions = np.concatenate([rng.normal(size=(34, 3)), axis @ box.axes, -axis @ box.axes])
    found = box.exit_patches(inside, directions.astype(np.float32))
    start, way = inside @ box.axes.T, directions @ box.axes.T
    with np.errstate(divide="ignore"):
        distance = np.where(way > 0, (box.high - start) / way, (box.low - start) / way)
    distance[np.abs(way) < 1e-9] = np.inf
    leaves = start + distance.min(axis=1, keepdims=True) * way
    half = 0.5 * (box.high - box.low) / CELLS + 1e-3
    centres, normals = box.patches()
    apart = np.abs(leaves - centres[found] @ box.axes.T)
    assert (np.where(np.abs(normals[found] @ box.axes.T) > 0.5, apart < 1e-4, apart < half)).all()


def test_many_rays_end_where_single_ones_do() -> None:
    caster, rng = RayCaster(room()), np.random.default_rng(0)
    origins, directions = rng.uniform(-1, 1, (7, 3)), rng.normal(size=(7, 20_000, 3))
    found = caster.nearest_faces(origins, directions.astype(np.float32))
    single = [caster.cast(origin, rays.astype(np.float32)).face for origin, rays in zip(origins, directions)]
    assert (found == np.stack(single)).mean() > 0.99999 and (found >= 0).mean() > 0.9999


def test_what_leaves_through_an_opening_sends_nothing_back() -> None:
    mesh = room()
    open_wall = trimesh.Trimesh(
        mesh.vertices, mesh.faces[mesh.triangles_center[:, 0] < 1.99], vertex_normals=mesh.vertex_normals,
        process=False,
    )  # fmt: skip
    opening = Aperture.facing((2.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), 3.0, 2.5)
    with_opening, without = (transport_of(open_wall, openings) for openings in ((opening,), ()))
    last = len(open_wall.faces) + 6 * CELLS**2
    assert (np.asarray(with_opening.hits) == last).any() and not (np.asarray(without.hits) == last).any()
    points = without.position.shape[0]
    light = [bounce(t, jnp.full((points, 3), 0.5), jnp.ones((points, 3))) for t in (with_opening, without)]
    assert float(light[0].mean()) < 0.95 * float(light[1].mean())


def test_vertices_without_a_normal_cast_usable_rays() -> None:
    mesh = room()
    normals = np.array(mesh.vertex_normals)
    normals[:3] = 0.0
    normals[3] = np.nan
    broken = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=normals, process=False)
    caster = RayCaster(mesh)
    caster.mesh = broken
    hits, _, normal = trace(caster, enclose(RayCaster(mesh), UP), rays=16)
    assert np.isfinite(normal).all() and (hits >= 0).all()


def test_gradient_of_bounces_is_that_of_finite_differences(closed: Transport) -> None:
    rng = np.random.default_rng(1)
    with jax.enable_x64(True):
        points = closed.position.shape[0]
        albedo, direct, weight, way = (jnp.asarray(rng.uniform(0.1, 0.9, (points, 3))) for _ in range(4))
        double = dataclasses.replace(closed, position=jnp.asarray(closed.position, jnp.float64))

        def total(t: float) -> jax.Array:
            return jnp.sum(weight * bounce(double, albedo, direct + t * way))

        slope = jax.grad(total)(0.0)
        step = 1e-4
        np.testing.assert_allclose(slope, (total(step) - total(-step)) / (2 * step), rtol=1e-7)


def test_gather_is_the_mean_of_what_rays_end_on() -> None:
    rng = np.random.default_rng(2)
    hits, sent = rng.integers(0, 7, (5, 4)), rng.random((7, 3)).astype(np.float32)
    found = gather(jnp.asarray(hits, jnp.int32), jnp.asarray(sent))
    np.testing.assert_allclose(found, sent[hits].mean(axis=0), rtol=1e-6)


def test_triangles_send_the_mean_of_their_corners(closed: Transport) -> None:
    values = jnp.asarray(np.random.default_rng(3).random((closed.position.shape[0], 3)), jnp.float32)
    sent = np.asarray(send(closed, values))
    np.testing.assert_allclose(sent[: len(closed.faces)], np.asarray(values)[closed.faces].mean(axis=1), rtol=1e-5)
    assert (sent[-1] == 0).all()


def test_bounced_light_is_linear_in_the_lamp(closed: Transport) -> None:
    even = jnp.ones((closed.vertices, 3))
    albedo = jnp.full((closed.position.shape[0], 3), 0.5)
    photo = PhotoLight(even, even[None], jnp.ones(3), albedo, closed)
    lamp = PointLight(jnp.zeros(3), jnp.float32(500.0), jnp.ones(3))
    once = bounced_light(photo, [lamp])
    twice = bounced_light(photo, [dataclasses.replace(lamp, luminous_flux=jnp.float32(1000.0))])
    np.testing.assert_allclose(twice, 2 * once, rtol=1e-5)
    # All of the lamp's light is met by walls of albedo 1/2: E / 2 + E / 4 + … over an area S is Φ / S.
    area = 2 * (4 * 3 + 4 * 2.5 + 3 * 2.5)
    assert float(jnp.mean(once)) == pytest.approx(500 / area, rel=0.2)


@pytest.mark.parametrize("lights", [[], [AmbientLight(jnp.float32(80.0), jnp.ones(3))]])
def test_where_nothing_bounces_bounces_are_none(lights: list[AmbientLight], closed: Transport) -> None:
    even = jnp.ones((closed.vertices, 3))
    albedo = jnp.full((closed.position.shape[0], 3), 0.5)
    photo = PhotoLight(even, even[None], jnp.ones(3), albedo, closed)
    found = jax.jit(lambda photo: bounced_light(photo, lights))(photo)
    assert found.shape == even.shape and float(jnp.abs(found).max()) == 0.0


def test_bounced_light_of_lamps_adds_up_though_outliers_are_held_back(closed: Transport) -> None:
    """A lamp close to a wall makes single vertices stand out, which even light of another lamp would hide."""
    even = jnp.ones((closed.vertices, 3))
    albedo = jnp.asarray(np.random.default_rng(4).uniform(0.0, 0.9, (closed.position.shape[0], 3)), jnp.float32)
    photo = PhotoLight(even, even[None], jnp.ones(3), albedo, closed)
    corner = np.abs(closed.position[: closed.vertices]).max(axis=0) * 0.9
    near = PointLight(jnp.asarray(corner, jnp.float32), jnp.float32(300.0), jnp.array([1.0, 0.5, 0.2]))
    far = PointLight(jnp.zeros(3), jnp.float32(3000.0), jnp.ones(3))
    alone = bounced_light(photo, [near]), bounced_light(photo, [far])
    np.testing.assert_allclose(bounced_light(photo, [near, far]), alone[0] + alone[1], rtol=1e-5)


def test_vertex_values_are_interpolated_and_holes_are_zero() -> None:
    values, faces = jnp.asarray([[0.0], [1.0], [2.0]]), jnp.asarray([[0, 1, 2]])
    weights = jnp.asarray([[[0.5, 0.25, 0.25], [1.0, 0.0, 0.0]]])
    found = interpolate(values, faces, jnp.asarray([[0, -1]]), weights)
    np.testing.assert_allclose(found[0, :, 0], [0.75, 0.0])
