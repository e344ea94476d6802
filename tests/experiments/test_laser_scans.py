"""Laser scans of a venue: scans written as Apple does come back in the world's axes."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from experiments.laser_scans import load_laser_scans
from hyjax.geometry.raycast import RayCaster
from hyjax.synthetic.room import camera_path, make_room
from hyjax.util.errors import InputError
from tests.reference.laser_export import Kind, export_laser_scans


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
    mesh = load_laser_scans(tmp_path, 0.05, progress=False)
    points = np.asarray(mesh.vertices).reshape(-1, 4, 3).mean(axis=1)
    assert len(points) > 10_000
    to_walls = np.abs(np.abs(points) - [2.0, 1.5, 1.25]).min(axis=1)
    distance = np.minimum(to_walls, np.abs(np.abs(points[:, 0]) - 0.05))
    assert np.quantile(distance, 0.95) < 1e-5  # in corners the mean of a cell lies off the walls
    assert distance.max() < 0.05
    np.testing.assert_allclose(points.min(axis=0), rooms.bounds[0], atol=0.02)
    np.testing.assert_allclose(points.max(axis=0), rooms.bounds[1], atol=0.02)


@pytest.mark.slow
def test_the_room_from_its_scans_against_its_mesh(tmp_path: Path) -> None:
    """The tolerances leave room for silhouettes, a disc (here 2 cm) fatter, and for edges, round by as much."""
    mesh = make_room(0).mesh
    camera = camera_path(6, 160, 120)[4]
    stands = [stand(tuple(seen_from.origin), n) for n, seen_from in enumerate(camera_path(4, 64, 64))]
    export_laser_scans(tmp_path, mesh, stands, 300_000)
    truth = RayCaster(mesh).gbuffer(camera)
    seen = RayCaster(load_laser_scans(tmp_path, 0.02, progress=False)).gbuffer(camera)
    hit, true_hit = np.asarray(seen.hit), np.asarray(truth.hit)
    assert np.mean(hit == true_hit) > 0.99
    both = hit & true_hit
    error = np.abs(np.asarray(seen.depth) - np.asarray(truth.depth))[both]
    assert np.median(error) < 0.002 and np.mean(error < 0.03) > 0.88
    cosine = np.sum(np.asarray(seen.normal) * np.asarray(truth.normal), axis=-1)[both]
    assert np.degrees(np.arccos(np.clip(np.median(cosine), -1, 1))) < 2.0
    assert np.mean(cosine > np.cos(np.deg2rad(20))) > 0.75


def test_what_is_missing_is_named(venue: Path, tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    refused(empty, "holds no laser scan <id>.ply")
    (venue / "468001_pose.txt").unlink()
    refused(venue, "468001_pose.txt: missing")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 0 0\n0 1 0\n0 0 1\n", "has 9 numbers"),
        ("1 0 0\n0 1 0\n0 0 one\n0 0 0\n", "plain numbers"),
        ("2 0 0\n0 2 0\n0 0 2\n0 0 0\n", "not a rigid motion"),
        ("0 0 0\n1 0 0\n0 1 0\n0 0 1\n", "not a rigid motion"),  # the translation first
    ],
)
def test_malformed_poses_are_refused(venue: Path, text: str, said: str) -> None:
    (venue / "468000_pose.txt").write_text(text)
    refused(venue, "468000_pose.txt", said)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
def test_bad_scans_are_refused(venue: Path, kind: Kind) -> None:
    walls = trimesh.creation.box((4.0, 3.0, 2.5))
    export_laser_scans(venue, walls, [stand((-1.0, 0.2, 0.1), 1)], 2000, kind)
    scan = venue / "468000.ply"
    whole = scan.read_bytes()
    scan.write_bytes(whole[:-100])
    refused(venue, "468000.ply: ", "truncated")
    if kind != "ascii":
        far = np.frombuffer(whole, np.uint8).copy()
        far[whole.index(b"end_header\n") + 11 :][:4] = np.frombuffer(np.float32(1e7).tobytes(), np.uint8)
        scan.write_bytes(far.tobytes())
        refused(venue, "468000.ply", "are they in metres?")
