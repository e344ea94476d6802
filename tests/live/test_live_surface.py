"""Volume that forgets, mesh in pieces, caster of pieces, and shadow maps that follow."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from boxes import frames, looking, room
from scipy.spatial import cKDTree

from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.geometry.surface import zero_crossing
from hyjax.light.kinds import Aperture, DirectionalLight, Light, PointLight, SpotLight
from hyjax.live.caster import LiveCaster
from hyjax.live.mesh import LiveMesh
from hyjax.live.shadow import LiveShadowMaps, LiveSurface
from hyjax.live.volume import KEPT_SHARE, UNSEEN_VALUE, LiveVolume
from hyjax.util.errors import InputError

VOXEL = 0.05
WHITE = np.ones(3, np.float32)
MIDDLE, FAR = (0.0, 0.0, 0.2), (2.2, 1.9, 0.2)


def volume_of(seen: list, volume: LiveVolume | None = None, max_depth: float = 5.0) -> LiveVolume:
    volume = volume or LiveVolume(VOXEL)
    with ThreadPoolExecutor(2) as pool:
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
    dense = np.full((size[0], 8, size[1], 8, size[2], 8), UNSEEN_VALUE, np.float32)
    x, y, z = (blocks - low).T
    dense[x, :, y, :, z, :] = distance.reshape(-1, 8, 8, 8)
    dense = dense.reshape(tuple(8 * size))
    vertices, faces = zero_crossing(
        np.where(dense < UNSEEN_VALUE, dense, 1.0).astype(np.float32), dense < UNSEEN_VALUE
    )
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
    assert KEPT_SHARE * 300 <= volume.count <= 300
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


def test_a_caster_of_pieces_sees_what_their_mesh_shows(before: list) -> None:
    mesh = LiveMesh(volume_of(before))
    mesh.renew()
    caster = LiveCaster(mesh.pieces)
    one, camera = RayCaster(mesh.whole()), before[20].camera
    np.testing.assert_allclose(caster.bounds, one.mesh.bounds)
    np.testing.assert_array_equal(caster.mesh.triangles, one.mesh.triangles)
    whole, pieces = one.gbuffer(camera), caster.gbuffer(camera)
    assert np.asarray(whole.hit).mean() > 0.5
    for name in ("hit", "depth", "face"):
        np.testing.assert_array_equal(getattr(pieces, name), getattr(whole, name))
    hit = np.asarray(whole.hit)
    assert np.einsum("nk,nk->n", np.asarray(pieces.normal)[hit], np.asarray(whole.normal)[hit]).min() > 0.999
    rays = camera.rays().reshape(-1, 3)
    start = np.broadcast_to(camera.origin, rays.shape)
    np.testing.assert_array_equal(one.occluded(start, rays, 1.9), caster.occluded(start, rays, 1.9))


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
def test_shadow_maps_follow_the_surface(before: list, after: list, name: str) -> None:
    volume = volume_of(before)
    mesh, light, scale = LiveMesh(volume), LIGHTS[name], 0.25
    mesh.renew()
    first = LiveSurface(LiveCaster(mesh.pieces), 1, mesh.whole().bounds)
    volume_of(after, volume)
    mesh.renew()
    second = LiveSurface(LiveCaster(mesh.pieces), 2, mesh.whole().bounds)
    maps = LiveShadowMaps()
    old, new = (maps(light, surface, scale) for surface in (first, second))
    assert old is not None and new is not None
    for surface, made in ((first, old), (second, new)):
        (usual,) = cast_shadow_maps(surface.caster, [light], scale)
        assert usual is not None
        np.testing.assert_array_equal(made.depth, usual.depth)
    assert np.mean(np.asarray(old.depth) != np.asarray(new.depth)) > 0.001
    assert maps(light, second, scale) is new
    assert maps(light, first, scale) is new, "of a picture that was begun before"
