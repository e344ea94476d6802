"""Point clouds: positions in PLY files, thinning, normals and spacing."""

import logging
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from hyjax.geometry import ply
from hyjax.geometry.ply import load_points
from hyjax.geometry.point_cloud import make_point_cloud
from hyjax.geometry.voxels import REACH, VoxelMean, voxel_coordinates, voxel_keys
from hyjax.util.errors import InputError
from tests.reference.laser_export import Kind, write_point_ply

KINDS: list[Kind] = ["ascii", "binary_little_endian", "binary_big_endian"]
XYZ = "property float x\nproperty float y\nproperty float z\n"
ROW = b"1 2 3\n"


def some_points(count: int = 100) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(count, 3)).astype(np.float32)


def ascii_ply(header: str, rows: bytes) -> bytes:
    return f"ply\nformat ascii 1.0\n{header}end_header\n".encode() + rows


def refused(path: Path, *parts: str) -> None:
    with pytest.raises(InputError) as caught:
        load_points(path)
    assert "\n" not in str(caught.value)
    for part in (path.name, *parts):
        assert part in str(caught.value)


# ---- files ----


@pytest.mark.parametrize("kind", KINDS)
def test_all_kinds_give_the_same_points(tmp_path: Path, kind: Kind, monkeypatch: pytest.MonkeyPatch) -> None:
    points = some_points()
    write_point_ply(tmp_path / "scan.ply", points, kind)
    np.testing.assert_array_equal(load_points(tmp_path / "scan.ply"), points)
    monkeypatch.setattr(ply, "ROWS", 7)
    monkeypatch.setattr(ply, "TEXT_ROWS", 50)
    np.testing.assert_array_equal(load_points(tmp_path / "scan.ply"), points)


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_a_mesh_is_read_as_its_vertices(tmp_path: Path, encoding: str) -> None:
    """With normals, and with lists of faces behind."""
    mesh = trimesh.creation.icosphere(1)
    (tmp_path / "mesh.ply").write_bytes(mesh.export(file_type="ply", encoding=encoding, vertex_normal=True))
    np.testing.assert_allclose(load_points(tmp_path / "mesh.ply"), mesh.vertices, atol=1e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_other_elements_other_order_other_types(tmp_path: Path, kind: Kind) -> None:
    """Another element comes first, coordinates are doubles among other properties, lines end as on Windows."""
    order = ">" if kind == "binary_big_endian" else "<"
    stands = np.zeros(3, [("id", f"{order}i4"), ("height", f"{order}f8")])
    rows = np.zeros(20, [("quality", "u1"), ("z", f"{order}f8"), ("x", f"{order}f8"), ("y", f"{order}f8")])
    points = np.random.default_rng(0).normal(size=(20, 3)) + 1e4
    rows["x"], rows["y"], rows["z"] = points.T
    header = (
        f"ply\nformat {kind} 1.0\ncomment by hand\nobj_info none\n"
        "element stand 3\nproperty int32 id\nproperty float64 height\n"
        "element vertex 20\nproperty uint8 quality\nproperty double z\nproperty double x\nproperty double y\n"
        "end_header\n"
    )
    body = stands.tobytes() + rows.tobytes()
    if kind == "ascii":
        body = b"".join(" ".join(map(repr, row)).encode() + b"\r\n" for row in [*stands.tolist(), *rows.tolist()])
    (tmp_path / "scan.ply").write_bytes(header.replace("\n", "\r\n").encode() + body)
    read = load_points(tmp_path / "scan.ply")
    assert read.dtype == np.float64  # single precision would move these points by a millimetre
    np.testing.assert_array_equal(read, points)


@pytest.mark.parametrize("kind", KINDS)
@given(share=st.floats(0, 0.99))
def test_a_file_cut_off_anywhere_is_refused(
    tmp_path_factory: pytest.TempPathFactory, kind: Kind, share: float
) -> None:
    path = tmp_path_factory.mktemp("cut") / "scan.ply"
    write_point_ply(path, some_points(), kind)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    refused(path)


@pytest.mark.parametrize("kind", KINDS)
def test_how_much_is_left_is_said(tmp_path: Path, kind: Kind) -> None:
    path = tmp_path / "scan.ply"
    write_point_ply(path, some_points(), kind)
    whole = path.read_bytes()
    rows_begin = whole.index(b"end_header\n") + 11
    end = [i for i, byte in enumerate(whole) if byte == 10][-31] + 1 if kind == "ascii" else rows_begin + 70 * 15
    path.write_bytes(whole[:end])
    refused(path, "truncated, has 70 of 100 vertices")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "not a PLY file"),
        (b"\x89PNG\r\n\x1a\n" + bytes(100), "not a PLY file"),
        (b"ply\n" + bytes(100_000), "not a PLY header"),
        (b"ply\n" + b"comment a\n" * 20_000, "not a PLY header"),
        (ascii_ply("element vertex many\n" + XYZ, ROW), "'element vertex many'"),
        (ascii_ply("element vertex -1\n" + XYZ, ROW), "'element vertex -1'"),
        (ascii_ply("element vertex 1\nproperty quaternion x\n", ROW), "'property quaternion x'"),
        (ascii_ply(f"element vertex 1\n{XYZ}property float y\n", b"1 2 3 4\n"), "'property float y'"),
        (ascii_ply(f"element camera {10**20}\nelement vertex 1\n{XYZ}", ROW), "truncated, has 0 of 1"),
        (
            f"ply\nformat binary_little_endian 1.0\nelement camera {10**20}\nproperty float a\n".encode()
            + f"element vertex 1\n{XYZ}end_header\n".encode()
            + bytes(12),
            "truncated, has 0 of 1",
        ),
        (ascii_ply("property float x\n", ROW), "'property float x'"),
        (b"ply\nformat binary_middle_endian 1.0\nend_header\n", "binary_middle_endian"),
        (f"ply\nelement vertex 1\n{XYZ}end_header\n".encode() + ROW, "no 'format' line"),
        (ascii_ply("element face 1\nproperty list uchar int vertex_indices\n", b"3 0 1 2\n"), "has no vertices"),
        (ascii_ply("element vertex 0\n" + XYZ, b""), "has no vertices"),
        (ascii_ply("element vertex 1\nproperty float x\nproperty float y\n", b"1 2\n"), "they have x, y"),
        (ascii_ply(f"element vertex 1\n{XYZ}property list uchar int seen_by\n", b"1 2 3 1 7\n"), "no lists"),
        (ascii_ply("element vertex 2\n" + XYZ, ROW + b"1 2\n"), "malformed or truncated after vertex 0"),
        (ascii_ply("element vertex 2\n" + XYZ, ROW + b"\n"), "malformed or truncated after vertex 0"),
        (ascii_ply("element vertex 2\n" + XYZ, b"1 2\n1 2\n"), "each needs 3 numbers"),
        (ascii_ply("element vertex 2\n" + XYZ, ROW + b"1 2 here\n"), "malformed or truncated after vertex 0"),
        (
            b"ply\nformat binary_little_endian 1.0\nelement face 1\nproperty list uchar int vertex_indices\n"
            b"element vertex 1\n" + XYZ.encode() + b"end_header\n" + bytes(100),
            "'face' with its lists comes before the vertices",
        ),
        (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 999999999999999999\n"
            + XYZ.encode()
            + b"end_header\n"
            + bytes(120),
            "has 10 of 999999999999999999",
        ),
    ],
)
def test_what_is_no_point_cloud_is_refused(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "scan.ply"
    path.write_bytes(content)
    refused(path, said)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    refused(tmp_path / "scan.ply", "no such file")


@pytest.mark.parametrize("kind", KINDS)
def test_a_few_points_may_be_no_numbers(tmp_path: Path, kind: Kind, caplog: pytest.LogCaptureFixture) -> None:
    points = some_points(1000)
    points[[3, 5], [0, 2]] = np.nan, np.inf
    write_point_ply(tmp_path / "scan.ply", points, kind)
    with caplog.at_level(logging.WARNING):
        np.testing.assert_array_equal(load_points(tmp_path / "scan.ply"), np.delete(points, [3, 5], axis=0))
    assert "dropped 2 points" in caplog.text
    points[:11, 1] = np.nan
    write_point_ply(tmp_path / "scan.ply", points, kind)
    refused(tmp_path / "scan.ply", "11 of 1000 points are NaN or infinite")


# ---- thinning ----


def test_voxel_keys_are_unique_and_ordered() -> None:
    corners = np.array([-REACH, -1, 0, REACH - 1])
    cells = np.stack(np.meshgrid(corners, corners, corners, indexing="ij"), axis=-1).reshape(-1, 3)
    keys = voxel_keys(cells)
    assert np.all(np.diff(keys) > 0)
    np.testing.assert_array_equal(voxel_coordinates(keys), cells)


@given(st.integers(0, 2**31), st.integers(1, 5))
def test_thinning_is_the_mean_of_each_cell_however_it_comes(seed: int, pieces: int) -> None:
    rng = np.random.default_rng(seed)
    points, voxel = rng.normal(size=(300, 3)), rng.uniform(0.1, 2.0)
    thinner = VoxelMean(voxel)
    for piece in np.array_split(points, pieces):
        thinner.add(piece)
    cells: dict[tuple[int, ...], list[np.ndarray]] = {}
    for point in points:
        cells.setdefault(tuple(np.floor(point / voxel).astype(int)), []).append(point)
    means = [np.mean(cells[cell], axis=0) for cell in sorted(cells)]
    np.testing.assert_allclose(thinner.points(), means, atol=1e-5)


@pytest.mark.parametrize("voxel", [0.0, -1.0, np.nan, np.inf])
def test_a_voxel_that_is_no_length_is_refused(voxel: float) -> None:
    with pytest.raises(InputError, match=r"voxel: must be > 0"):
        VoxelMean(voxel)


def test_points_beyond_the_grid_are_refused() -> None:
    VoxelMean(0.005).add(np.full((1, 3), 5000.0))
    with pytest.raises(InputError, match="are they in metres"):
        VoxelMean(0.005).add(np.full((1, 3), 1e6))


# ---- normals and spacing ----


def grid(n: int, spacing: float) -> np.ndarray:
    i, j = np.mgrid[:n, :n]
    return np.stack([i, j, np.zeros_like(i)], axis=-1).reshape(-1, 3) * spacing


def test_a_plane() -> None:
    cloud = make_point_cloud(grid(30, 0.02), progress=False)
    assert len(cloud) == 900
    np.testing.assert_allclose(np.abs(cloud.normals), np.broadcast_to([0, 0, 1.0], (900, 3)), atol=1e-6)
    inner = ((cloud.points > 0.03) & (cloud.points < 0.55))[:, :2].all(axis=1)
    np.testing.assert_allclose(cloud.radius[inner], 0.02 * np.sqrt(2), rtol=1e-5)  # its four diagonal neighbours


def test_a_sphere_thinned() -> None:
    points, _ = trimesh.sample.sample_surface(trimesh.creation.icosphere(5), 200_000, seed=0)
    cloud = make_point_cloud(points, voxel=0.04, progress=False)
    assert 3000 < len(cloud) < 4 * np.pi / 0.04**2 * 2
    cosine = np.abs(np.sum(cloud.normals * cloud.points, axis=1)) / np.linalg.norm(cloud.points, axis=1)
    assert np.degrees(np.arccos(np.quantile(cosine, 0.05))) < 4.0
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1.0, rtol=1e-5)
    assert np.all((cloud.radius > 0.02) & (cloud.radius < 0.12))


def test_isolated_points_go_and_sparse_parts_stay() -> None:
    """A scanner's points lie a hundred times sparser on a far wall: that is no reason to drop them."""
    dense, sparse = grid(40, 0.005), grid(15, 0.05) + np.array([3.0, 0, 0])
    stray = np.array([[0.1, 0.1, 0.2], [0.102, 0.1, 0.2], [0.05, 0.1, -0.5]])
    cloud = make_point_cloud(np.concatenate([dense, sparse, stray]), progress=False)
    np.testing.assert_array_equal(cloud.points, np.concatenate([dense, sparse]).astype(np.float32))


@pytest.mark.parametrize(
    ("points", "said"),
    [
        (grid(4, 1.0), r"16 points make no surface; need at least 17"),
        (np.zeros((100, 2)), r"shape \(n, 3\)"),
        (np.full((100, 3), np.nan), "finite"),
    ],
)
def test_points_that_make_no_surface_are_refused(points: np.ndarray, said: str) -> None:
    with pytest.raises(InputError, match=said):
        make_point_cloud(points, progress=False)


def test_too_coarse_a_voxel_is_named() -> None:
    with pytest.raises(InputError, match=r"1 points at a voxel of 5 m"):
        make_point_cloud(np.random.default_rng(0).uniform(1, 4, (1000, 3)), voxel=5.0, progress=False)
