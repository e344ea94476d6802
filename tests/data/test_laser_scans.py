"""The laser scans of a venue: what the tests export as Apple does comes back in the world's axes."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from hyjax.data import laser_scans
from hyjax.data.laser_scans import load_laser_scans
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.splatting import PointSplatter
from hyjax.synthetic.room import camera_path, make_room
from hyjax.util.errors import InputError
from tests.reference.laser_export import Kind, export_laser_scans


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def stand(position: tuple[float, float, float], seed: int) -> np.ndarray:
    """A scanner anyhow turned."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    pose[:3, 3] = position
    return pose


@pytest.fixture
def venue(tmp_path: Path) -> Path:
    """Two scans of an empty room of 4 × 3 × 2.5 m."""
    folder = tmp_path / "421059"
    folder.mkdir()
    walls = trimesh.creation.box((4.0, 3.0, 2.5))
    export_laser_scans(folder, walls, [stand((-1.0, 0.2, 0.1), 1), stand((1.1, -0.3, 0.0), 2)], 20_000)
    return folder


def refused(folder: Path, *parts: str) -> None:
    with pytest.raises(InputError) as caught:
        load_laser_scans(folder, 0.05, progress=False)
    assert "\n" not in str(caught.value)
    for part in parts:
        assert part in str(caught.value)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_scans_come_back_in_the_worlds_axes(tmp_path: Path, kind: Kind) -> None:
    """Each scan alone shows half of what there is: a wall between the stands hides the rest."""
    rooms = trimesh.creation.box((4.0, 3.0, 2.5))
    parting = trimesh.creation.box((0.1, 2.9, 2.4))
    export_laser_scans(tmp_path, rooms + parting, [stand((-1, 0, 0), 1), stand((1, 0, 0), 2)], 20_000, kind)
    cloud = load_laser_scans(tmp_path, 0.05, progress=False)
    assert len(cloud) > 10_000
    to_walls = np.abs(np.abs(cloud.points) - [2.0, 1.5, 1.25]).min(axis=1)
    distance = np.minimum(to_walls, np.abs(np.abs(cloud.points[:, 0]) - 0.05))
    assert np.quantile(distance, 0.95) < 1e-5  # in corners the mean of a cell lies off the walls
    assert distance.max() < 0.05
    np.testing.assert_allclose(cloud.points.min(axis=0), rooms.bounds[0], atol=0.02)
    np.testing.assert_allclose(cloud.points.max(axis=0), rooms.bounds[1], atol=0.02)


@pytest.mark.slow
def test_the_room_from_its_scans_against_its_mesh() -> None:
    """The tolerances leave room for silhouettes, a disc (here 2 cm) fatter, and for edges, round by as much."""
    mesh = make_room(0).mesh
    camera = camera_path(make_room(0), 6, 160, 120)[4]
    folder = laser_scans.cache_folder() / "scans"
    folder.mkdir(parents=True)
    stands = [stand(tuple(seen_from.origin), n) for n, seen_from in enumerate(camera_path(make_room(0), 4, 64, 64))]
    export_laser_scans(folder, mesh, stands, 300_000)
    truth = RayCaster(mesh).gbuffer(camera)
    seen = PointSplatter(load_laser_scans(folder, 0.02, progress=False)).gbuffer(camera)
    hit, true_hit = np.asarray(seen.hit), np.asarray(truth.hit)
    assert np.mean(hit == true_hit) > 0.99
    both = hit & true_hit
    error = np.abs(np.asarray(seen.depth) - np.asarray(truth.depth))[both]
    assert np.median(error) < 0.002 and np.mean(error < 0.03) > 0.88
    cosine = np.sum(np.asarray(seen.normal) * np.asarray(truth.normal), axis=-1)[both]
    assert np.degrees(np.arccos(np.clip(np.median(cosine), -1, 1))) < 2.0
    assert np.mean(cosine > np.cos(np.deg2rad(20))) > 0.75


def test_a_cloud_is_made_once(venue: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = load_laser_scans(venue, 0.05, progress=False)
    coarse = load_laser_scans(venue, 0.1, progress=False)
    assert len(coarse) < len(first) / 2
    assert len(list(cache.iterdir())) == 2

    def read(path: Path) -> None:
        raise AssertionError(f"{path} is read again")

    with monkeypatch.context() as patch:
        patch.setattr(laser_scans, "read_points", read)
        again = load_laser_scans(venue, 0.05, progress=False)
        for name in ("points", "normals", "radius"):
            np.testing.assert_array_equal(getattr(again, name), getattr(first, name))
            assert getattr(again, name).dtype == np.float32
        pose = next(venue.glob("*_pose.txt"))
        pose.write_text(pose.read_text() + "\n")
        with pytest.raises(AssertionError, match="is read again"):
            load_laser_scans(venue, 0.05, progress=False)


@pytest.mark.parametrize("damage", [b"", b"not a zip file", None])
def test_a_damaged_copy_is_made_again(venue: Path, cache: Path, damage: bytes | None) -> None:
    first = load_laser_scans(venue, 0.05, progress=False)
    (kept,) = cache.iterdir()
    kept.write_bytes(kept.read_bytes()[:5000] if damage is None else damage)
    np.testing.assert_array_equal(load_laser_scans(venue, 0.05, progress=False).points, first.points)
    assert kept.stat().st_size > 28 * len(first)


def test_what_is_missing_is_named(venue: Path, tmp_path: Path) -> None:
    refused(tmp_path / "nowhere", "nowhere: no such folder")
    empty = tmp_path / "empty"
    empty.mkdir()
    refused(empty, "holds no laser scan <id>.ply")
    (venue / "468001_pose.txt").unlink()
    refused(venue, "468001_pose.txt: missing")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 0 0\n0 1 0\n0 0 1\n", "has 9 numbers"),
        ("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "has 16 numbers"),
        ("1 0 0\n0 1 0\n0 0 one\n0 0 0\n", "plain numbers"),
        ("2 0 0\n0 2 0\n0 0 2\n0 0 0\n", "not a rigid motion"),
        ("1 0 0\n0 1 0\n0 0 -1\n0 0 0\n", "not a rigid motion"),
        ("1 0 0\n0 1 0\n0 0 1\n0 nan 0\n", "finite"),
        ("0 0 0\n1 0 0\n0 1 0\n0 0 1\n", "not a rigid motion"),  # the translation first
    ],
)
def test_malformed_poses_are_refused(venue: Path, text: str, said: str) -> None:
    (venue / "468000_pose.txt").write_text(text)
    refused(venue, "468000_pose.txt", said)


def test_bad_scans_are_refused_and_nothing_is_kept(venue: Path, cache: Path) -> None:
    scan = venue / "468001.ply"
    whole = scan.read_bytes()
    scan.write_bytes(whole[:-100])
    refused(venue, "468001.ply: truncated")
    far = np.frombuffer(whole, np.uint8).copy()
    far[whole.index(b"end_header\n") + 11 :][:4] = np.frombuffer(np.float32(1e7).tobytes(), np.uint8)
    scan.write_bytes(far.tobytes())
    refused(venue, "468001.ply", "are they in metres?")
    assert not cache.exists()
