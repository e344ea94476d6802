"""Volume that forgets, mesh in pieces, caster of trees, and shadow maps renewed in part."""

import dataclasses

import numpy as np
import pytest
from boxes import frames, looking, room
from scipy.spatial import cKDTree

from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.geometry.surface import zero_crossing
from hyjax.light.kinds import Aperture, DirectionalLight, Light, PointLight, SpotLight
from hyjax.live import caster as caster_module
from hyjax.live.caster import LiveCaster
from hyjax.live.mesh import LiveMesh
from hyjax.live.shadow import LiveShadowMaps, LiveSurface, Spheres
from hyjax.live.volume import LEFT, UNSEEN, LiveVolume, make_pool
from hyjax.util.errors import InputError

VOXEL = 0.05
WHITE = np.ones(3, np.float32)
MIDDLE, FAR = (0.0, 0.0, 0.2), (2.2, 1.9, 0.2)


def volume_of(seen: list, volume: LiveVolume | None = None, max_depth: float = 5.0) -> LiveVolume:
    volume = volume or LiveVolume(VOXEL)
    with make_pool(2) as pool:
        for frame in seen:
            volume.integrate(frame.depth, frame.camera, max_depth, pool)
    return volume


@pytest.fixture(scope="module")
def before() -> list:
    return frames(room(), [*looking(FAR, 12), *looking(MIDDLE, 20)])


@pytest.fixture(scope="module")
def after() -> list:
    """The box in the middle has gone."""
    return frames(room(box=False), looking(MIDDLE, 20), first=32)


def inside_box(mesh: LiveMesh) -> int:
    """Triangles where the middle box is, above the floor."""
    middles = mesh.whole().triangles_center
    return int(((np.abs(middles[:, :2]) < 0.35).all(axis=1) & (middles[:, 2] > 0.1)).sum())


def test_a_box_that_goes_is_forgotten_within_a_third_of_a_second(before: list, after: list) -> None:
    volume = volume_of(before)
    mesh = LiveMesh(volume)
    mesh.renew()
    assert inside_box(mesh) > 200
    volume_of(after[:10], volume)
    mesh.renew()
    assert inside_box(mesh) == 0
    # And one that comes is there again.
    volume_of(before[12:], volume)
    mesh.renew()
    assert inside_box(mesh) > 200


def test_regions_far_away_are_not_meshed_again(before: list, after: list) -> None:
    volume = volume_of(before)
    mesh = LiveMesh(volume)
    mesh.renew()
    kept = dict(mesh.pieces)
    assert mesh.renew()[0] == [], "nothing has changed since"
    volume_of(after, volume, 2.3)
    regions, _ = mesh.renew()
    assert 0 < len(kept.keys() & regions) < len(kept)
    for region, piece in kept.items():
        assert region in regions or mesh.pieces[region] is piece
    far = [region for region in kept if region[0] * 32 * VOXEL >= 1.5]
    assert far and all(mesh.pieces[region] is kept[region] for region in far)


def test_pieces_have_the_triangles_of_the_whole(before: list, after: list) -> None:
    volume = volume_of(before)
    mesh = LiveMesh(volume, clean=False)
    mesh.renew()
    volume_of(after[:5], volume)
    while mesh.renew(most=3)[0]:
        pass
    blocks, distance = volume.meshed()
    low, size = blocks.min(axis=0), np.ptp(blocks, axis=0) + 1
    dense = np.full((size[0], 8, size[1], 8, size[2], 8), UNSEEN, np.float32)
    x, y, z = (blocks - low).T
    dense[x, :, y, :, z, :] = distance.reshape(-1, 8, 8, 8)
    dense = dense.reshape(tuple(8 * size))
    vertices, faces = zero_crossing(np.where(dense < UNSEEN, dense, 1.0).astype(np.float32), dense < UNSEEN)
    whole = mesh.whole()
    corners = ((vertices + 8 * low) * VOXEL)[faces]
    assert len(whole.faces) == len(faces)
    for k in range(2):  # float32 rounds at another place here and there
        own, other = (corners.mean(axis=1), whole.triangles_center)[:: 1 - 2 * k]
        assert cKDTree(own).query(other)[0].max() < 1e-5


def test_normals_have_no_seams(before: list) -> None:
    mesh = LiveMesh(volume_of(before))
    mesh.renew()
    whole = mesh.whole()
    floor = (np.abs(whole.vertices[:, 2]) < 0.01) & (np.linalg.norm(whole.vertices[:, :2], axis=1) > 0.6)
    floor &= np.linalg.norm(whole.vertices[:, :2] - FAR[:2], axis=1) > 0.8
    floor &= whole.vertices[:, 1] < 1.0
    assert floor.sum() > 500
    assert np.percentile(whole.vertex_normals[floor] @ [0.0, 0.0, 1.0], 1) > 0.97


def test_memory_is_bounded(before: list) -> None:
    volume = volume_of(before, LiveVolume(VOXEL, most_blocks=300))
    assert LEFT * 300 <= volume.count <= 300
    mesh = LiveMesh(volume)
    mesh.renew()
    volume_of(before[:12], volume)
    mesh.renew()
    assert volume.count <= 300
    blocks = volume.meshed()[0]
    for region in mesh.pieces:
        low = np.array(region) * 4
        assert ((blocks >= low) & (blocks <= low + 4)).all(axis=1).any(), "the surface goes with its blocks"
    with pytest.raises(InputError, match="voxel"):
        LiveVolume(0.0)


def test_a_caster_of_trees_sees_what_one_tree_sees(
    before: list, after: list, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(caster_module, "FULL", 600)
    volume = volume_of(before)
    mesh = LiveMesh(volume)
    mesh.renew()
    first = LiveCaster.of(mesh.pieces, np.zeros(3))
    assert first is not None and len(first.trees) > 2
    volume_of(after, volume, 2.3)
    mesh.renew()
    second = first.renewed(mesh.pieces)
    assert second is not None and any(tree in first.trees for tree in second.trees)
    one, camera = RayCaster(mesh.whole()), before[20].camera
    assert len(second.mesh.faces) == len(one.mesh.faces)
    np.testing.assert_allclose(second.bounds, one.mesh.bounds)
    whole, trees = one.gbuffer(camera), second.gbuffer(camera)
    agree = np.asarray(whole.hit) == np.asarray(trees.hit)
    assert agree.mean() > 0.999
    hit = np.asarray(whole.hit & trees.hit)
    np.testing.assert_allclose(np.asarray(trees.depth)[hit], np.asarray(whole.depth)[hit], atol=1e-4)
    assert np.einsum("nk,nk->n", np.asarray(trees.normal)[hit], np.asarray(whole.normal)[hit]).min() > 0.999
    rays = camera.rays().reshape(-1, 3)
    start = np.broadcast_to(camera.origin, rays.shape)
    assert (one.occluded(start, rays, 1.9) == second.occluded(start, rays, 1.9)).mean() > 0.999
    assert second.renewed({}) is None


INWARDS = np.array([0.0, 1.0, -0.4])
WINDOW = Aperture.facing(np.array([0.0, -2.0, 1.5]), INWARDS, np.array([0.0, 0.0, 1.0]), 1.5, 1.5)
LIGHTS: dict[str, Light] = {
    "lamp": PointLight(np.array([1.0, -1.0, 1.8], np.float32), np.float32(800.0), WHITE),
    "bulb": PointLight(np.array([1.0, -1.0, 1.8], np.float32), np.float32(800.0), WHITE, 0.1),
    "spot": SpotLight(
        np.array([0.5, -1.0, 2.0], np.float32),
        np.array([-0.3, 0.6, -1.0], np.float32),
        np.float32(800.0),
        WHITE,
        0.4,
        0.7,
    ),
    "sun": DirectionalLight(np.array([0.3, 0.2, -1.0], np.float32), np.float32(900.0), WHITE),
    "sun through a window": DirectionalLight(
        np.array([0.1, 0.8, -0.6], np.float32), np.float32(900.0), WHITE, np.asarray(0.005, np.float32), WINDOW
    ),
}


@pytest.mark.parametrize("name", LIGHTS)
def test_a_map_renewed_in_part_is_the_map_cast_anew(before: list, after: list, name: str) -> None:
    volume = volume_of(before)
    mesh, light, scale = LiveMesh(volume), LIGHTS[name], 0.25
    mesh.renew()
    first = LiveCaster.of(mesh.pieces, np.zeros(3))
    assert first is not None
    bounds = np.array([[-4.0, -4.0, -1.0], [4.0, 4.0, 3.0]])
    maps = LiveShadowMaps()
    maps(name, light, LiveSurface(first, 1, (), bounds), scale)
    volume_of(after, volume)
    _, centres = mesh.renew()
    second = first.renewed(mesh.pieces)
    assert second is not None
    surface = LiveSurface(second, 2, ((2, Spheres(centres, mesh.reach)),), bounds)
    renewed = maps(name, light, surface, scale)
    assert renewed is not None and 0 < maps.cast[0] <= maps.cast[1]
    assert name == "sun through a window" or maps.cast[0] < maps.cast[1], "whose rays all pass the box"
    anew = LiveShadowMaps()(name, light, surface, scale)
    assert anew is not None
    np.testing.assert_array_equal(renewed.depth, anew.depth)
    if name != "sun":  # whose map here covers more than the mesh
        (usual,) = cast_shadow_maps(second, [light], scale)
        assert usual is not None
        np.testing.assert_array_equal(renewed.depth, usual.depth)
    kept = maps(name, light, dataclasses.replace(surface, revision=3, changes=()), scale)
    assert kept is not None and maps.cast[0] == maps.cast[1], "what changed is not known any more"
    np.testing.assert_array_equal(kept.depth, renewed.depth)


def test_many_spheres_become_few_that_hold_them() -> None:
    centres = np.random.default_rng(0).uniform(-3.0, 3.0, (1000, 3))
    few = Spheres(centres, 0.3).few(50)
    assert len(few.centres) <= 50
    nearest = np.linalg.norm(centres[:, None] - few.centres[None], axis=-1).min(axis=1)
    assert (nearest + 0.3 <= few.radius + 1e-9).all()
