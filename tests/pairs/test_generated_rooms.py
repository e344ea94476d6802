"""Generated rooms: true depth and normals, texture that is no border, the same everywhere, an honest cache."""

import hashlib
import logging
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import maximum_filter

from hyjax.geometry.camera import Camera
from hyjax.pairs.depth_pairs import DepthPair
from hyjax.pairs.generated_rooms import DEPTH_STEP, VERSION, GeneratedRooms
from hyjax.synthetic.random_room import LitRoom, make_random_room, photograph
from hyjax.synthetic.random_room.views import LEAST_DEPTH, draw_view
from hyjax.util.errors import InputError

SIZE = 96
COUNT = 12


@pytest.fixture(scope="module")
def rooms() -> GeneratedRooms:
    return GeneratedRooms(0, size=SIZE)


@pytest.fixture(scope="module")
def pairs(rooms: GeneratedRooms) -> list[DepthPair]:
    return [rooms[k] for k in range(COUNT)]


@pytest.fixture(scope="module")
def lit() -> LitRoom:
    return make_random_room(0, 1)


def camera_of(lit: LitRoom, view: int) -> Camera:
    return draw_view(lit.room, lit.caster, SIZE, np.random.default_rng((*lit.key, 2, view)))


def same(a: DepthPair, b: DepthPair) -> bool:
    assert a.normal is not None and b.normal is not None
    arrays = ((a.image, b.image), (a.depth, b.depth), (a.valid, b.valid), (a.normal, b.normal))
    return a.name == b.name and all(np.array_equal(x, y) for x, y in arrays)


def test_pairs(rooms: GeneratedRooms, pairs: list[DepthPair]) -> None:
    assert rooms.name == "rooms" and rooms.unit == "metres" and len(rooms) > 10**9
    for pair in pairs:
        assert pair.unit == "metres" and pair.normal is not None
        assert pair.image.shape == pair.normal.shape == (SIZE, SIZE, 3)
        assert pair.depth.shape == pair.valid.shape == (SIZE, SIZE)
        assert pair.image.dtype == pair.depth.dtype == pair.normal.dtype == np.float32 and pair.valid.dtype == bool
        assert pair.image.min() >= 0 and pair.image.max() <= 1 and pair.image.std() > 0.03
        assert pair.valid.mean() > 0.5
        assert (pair.depth[~pair.valid] == 0).all() and (pair.normal[~pair.valid] == 0).all()
    assert len({pair.name for pair in pairs}) == COUNT


def nearest(origin: np.ndarray, ray: np.ndarray, corners: np.ndarray) -> float:
    """Depth of the nearest of all triangles along a ray of unit depth, in float64 (Möller and Trumbore)."""
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(ray, e2)
    determinant = (e1 * p).sum(1)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = origin - corners[:, 0]
        u = (s * p).sum(1) / determinant
        q = np.cross(s, e1)
        v, t = q @ ray / determinant, (e2 * q).sum(1) / determinant
        hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t > 1e-6)
    return float(t[hit].min()) if hit.any() else 0.0


def test_depth_is_that_of_the_triangles(lit: LitRoom) -> None:
    camera, shot = camera_of(lit, 0), photograph(lit, 0, SIZE)
    mesh = lit.room.surface.mesh
    corners, rays = np.asarray(mesh.vertices)[mesh.faces], camera.rays()
    rng = np.random.default_rng(0)
    wrong = 0
    for i, j in rng.integers(0, SIZE, (40, 2)):
        expected = nearest(camera.origin, rays[i, j], corners)
        # Within float32 a ray may pass on the other side of a silhouette.
        wrong += abs(shot.depth[i, j] - expected) > 1e-4 * max(1, expected)
    assert wrong <= 1


def test_stored_depth_is_exact_to_its_step(rooms: GeneratedRooms, lit: LitRoom) -> None:
    pair, shot = rooms[4], photograph(lit, 0, SIZE)  # four views a room
    assert np.abs(pair.depth - shot.depth).max() <= DEPTH_STEP / 2 + 1e-6
    assert np.array_equal(pair.image, shot.image) and np.array_equal(pair.valid, shot.depth > 0)


def test_normals(lit: LitRoom) -> None:
    """Unit, towards the camera, and those of the surface that the depth describes."""
    for view in range(3):
        camera, shot = camera_of(lit, view), photograph(lit, view, SIZE)
        valid = shot.depth > 0
        np.testing.assert_allclose(np.linalg.norm(shot.normal[valid], axis=1), 1, atol=1e-5)
        rays = Camera(camera.intrinsics, np.eye(4)).rays()
        assert (shot.normal * rays).sum(-1)[valid].max() < 1e-5
        point = rays * shot.depth[..., None]
        across = np.cross(point[1:-1, 2:] - point[1:-1, :-2], point[2:, 1:-1] - point[:-2, 1:-1])
        length = np.linalg.norm(across, axis=-1)
        agreement = np.abs((across * shot.normal[1:-1, 1:-1]).sum(-1))[length > 0] / length[length > 0]
        assert np.median(agreement) > 0.999
        assert (agreement > 0.98).mean() > 0.6


def edges(pair: DepthPair) -> tuple[np.ndarray, np.ndarray]:
    """Where neighbours' colours differ clearly; where depth jumps or the surface bends."""
    assert pair.normal is not None
    grey = pair.image.mean(-1)
    inner = (slice(1, -1), slice(1, -1))
    color = np.hypot(grey[1:-1, 2:] - grey[1:-1, :-2], grey[2:, 1:-1] - grey[:-2, 1:-1])
    disparity = np.where(pair.valid, 1 / np.maximum(pair.depth, 0.1), 0)
    jump = maximum_filter(disparity, 3) > 1.06 * disparity + 1e-6
    bend = np.stack([maximum_filter(pair.normal[..., k], 3) - pair.normal[..., k] for k in range(3)]).max(0) > 0.3
    return color > 0.12, (jump | bend | ~pair.valid)[inner]


def test_texture_is_no_border_and_borders_are_seen() -> None:
    """What the pairs are for: plenty of edges in the picture where the surface has none, and not the reverse."""
    rooms = GeneratedRooms(0, size=160, views=1)
    color, border = (np.stack(a) for a in zip(*(edges(rooms[k]) for k in range(8))))
    near_border = np.stack([maximum_filter(b, 5) for b in border])
    near_color = np.stack([maximum_filter(c, 5) for c in color])
    assert color.mean() > 0.05 and 0.02 < border.mean() < 0.4
    assert (color & ~near_border).sum() > 0.2 * color.sum()
    seen = (border & near_color).sum() / border.sum()
    assert 0.5 < seen < 0.98  # some have next to no contrast, as in real rooms


def test_nothing_is_in_the_way_of_the_camera(pairs: list[DepthPair], lit: LitRoom) -> None:
    for pair in pairs:
        assert pair.depth[pair.valid].min() > 0.5 * LEAST_DEPTH
    for view in range(4):
        camera = camera_of(lit, view)
        rays = camera.rays().reshape(-1, 3)
        hits = lit.caster.cast(camera.origin, rays)
        facing = (lit.caster.mesh.face_normals[hits.face] * rays).sum(1)[hits.hit]
        assert (facing > 0).mean() < 0.05  # not from within a solid


def test_near_and_far(pairs: list[DepthPair]) -> None:
    middle = [np.median(pair.depth[pair.valid]) for pair in pairs]
    assert min(middle) < 1.3 and max(middle) > 2.2


def fingerprint(pair: DepthPair) -> str:
    assert pair.normal is not None
    arrays = (pair.image, pair.depth, pair.normal)
    return hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest()


@pytest.mark.slow
def test_same_in_every_process(pairs: list[DepthPair]) -> None:
    code = (
        "import sys; sys.path[:0] = ['tests/pairs', 'tests']; from test_generated_rooms import *; "
        "print(*(fingerprint(GeneratedRooms(0, size=SIZE)[k]) for k in (5, 2)))"
    )
    root = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root)
    assert done.stdout.split() == [fingerprint(pairs[5]), fingerprint(pairs[2])]


def test_same_in_any_order_and_from_threads(pairs: list[DepthPair]) -> None:
    again = GeneratedRooms(0, size=SIZE)
    order = [9, 1, 8, 0, 5]
    with ThreadPoolExecutor(3) as pool:
        assert all(same(found, pairs[k]) for k, found in zip(order, pool.map(again.__getitem__, order)))


def test_seed_and_number_of_views_matter(rooms: GeneratedRooms, pairs: list[DepthPair]) -> None:
    assert not np.array_equal(pairs[0].depth, pairs[1].depth)
    other = GeneratedRooms(0, size=SIZE, views=2)
    assert np.array_equal(other[2].image, pairs[4].image)  # the first view of the second room
    prints = {r.fingerprint for r in (rooms, other, GeneratedRooms(1, size=SIZE), GeneratedRooms(0))}
    assert len(prints) == 4 and rooms.fingerprint == GeneratedRooms(0, size=SIZE, cached=True).fingerprint


def test_cache(pairs: list[DepthPair], tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Kept rooms are the same pairs; a damaged file is named, replaced, and never seen."""

    def open_cached(**options: int) -> GeneratedRooms:
        return GeneratedRooms(0, size=SIZE, cached=True, cache_dir=tmp_path, **options)

    assert same(open_cached()[6], pairs[6])
    folder = tmp_path / f"rooms-v{VERSION}-seed0-{SIZE}x4"
    assert [file.name for file in folder.iterdir()] == ["0000001.npz"]
    file = folder / "0000001.npz"
    whole = file.read_bytes()
    assert same(open_cached()[5], pairs[5])
    for damage in (whole[: len(whole) // 2], b"", b"not a file of arrays"):
        file.write_bytes(damage)
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            assert same(open_cached()[7], pairs[7])
        assert "damaged" in caplog.text and file.read_bytes() == whole
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        assert same(open_cached()[7], pairs[7])
    assert not caplog.text
    open_cached(views=1)[0]
    assert len(list(tmp_path.iterdir())) == 2


def test_cache_that_cannot_be_written(
    pairs: list[DepthPair], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").touch()
    with caplog.at_level(logging.WARNING):
        assert same(GeneratedRooms(0, size=SIZE, cached=True, cache_dir=tmp_path / "file")[4], pairs[4])
    assert "cannot keep" in caplog.text


@pytest.mark.parametrize("options", [{"seed": -1}, {"views": 0}, {"size": 16}, {"size": 10**6}])
def test_bad_numbers(options: dict[str, int]) -> None:
    with pytest.raises(InputError, match="rooms: "):
        GeneratedRooms(**options)


def test_past_the_end(rooms: GeneratedRooms) -> None:
    with pytest.raises(IndexError):
        rooms[len(rooms)]
