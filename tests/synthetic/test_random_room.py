"""What random rooms are made of: plans without overlap, patterns, light with known answers, and a camera."""

import hypothesis.strategies as st
import numpy as np
import pytest
import trimesh
from hypothesis import given

from hyjax.geometry.raycast import RayCaster
from hyjax.synthetic.random_room import exposure, light, patterns, pieces, things
from hyjax.synthetic.random_room.bank import FAMILIES, Bank
from hyjax.synthetic.random_room.builder import RoomBuilder
from hyjax.synthetic.random_room.fittings import RoomWindow
from hyjax.synthetic.random_room.light import Lighting, Panel, Points, RoundLight
from hyjax.synthetic.random_room.looks import ROLES, Looks
from hyjax.synthetic.random_room.plan import FloorPlan, Furnishing, footprint, overlap

Box = tuple[float, float, float, float, float]
boxes = st.tuples(*[st.floats(-2, 2)] * 2, *[st.floats(0.1, 2)] * 2, st.floats(0, 360))


def samples(box: Box) -> np.ndarray:
    """Points inside a turned rectangle."""
    s, t = np.meshgrid(np.linspace(0.01, 0.99, 15), np.linspace(0.01, 0.99, 15))
    a = footprint(*box)
    return a[0] + s.reshape(-1, 1) * (a[1] - a[0]) + t.reshape(-1, 1) * (a[3] - a[0])


def inside(points: np.ndarray, box: Box) -> np.ndarray:
    a = footprint(*box)
    local = [(points - a[0]) @ e / (e @ e) for e in (a[1] - a[0], a[3] - a[0])]
    return (local[0] > 0) & (local[0] < 1) & (local[1] > 0) & (local[1] < 1)


@given(boxes, boxes)
def test_overlap(a: Box, b: Box) -> None:
    found = overlap(footprint(*a), footprint(*b))
    assert found == overlap(footprint(*b), footprint(*a))
    if inside(samples(a), b).any() or inside(samples(b), a).any():
        assert found


def test_overlap_is_not_that_of_bounding_boxes() -> None:
    assert not overlap(footprint(0, 0, 2, 0.1, 45), footprint(0.5, -0.5, 2, 0.1, 45))
    assert not overlap(footprint(0, 0, 1, 1, 0), footprint(1, 0, 1, 1, 0))  # they touch


@given(st.lists(boxes, min_size=1, max_size=12))
def test_plan(wanted: list[Box]) -> None:
    plan = FloorPlan((-2.0, -2.0), (2.0, 2.0))
    taken = [box for box in wanted if plan.take(*box)]
    for k, box in enumerate(taken):
        assert (np.abs(footprint(*box)) <= 2 + 1e-6).all()
        assert not any(inside(samples(box), other).any() for other in taken[:k])


@pytest.mark.parametrize("name", FAMILIES)
def test_patterns(name: str) -> None:
    """Shares in [0, 1], the same for the same seed, and something to see where a pattern is promised."""
    a, b = (FAMILIES[name].paint(64, np.random.default_rng(3)) for _ in range(2))
    assert a.shape == (64, 64, 3) and np.array_equal(a, b)
    seen = np.clip(a, 0, 1)
    assert seen.std(axis=(0, 1)).max() > (0.01 if name == "plain" else 0.03)


IMAGE = np.random.default_rng(0).random((32, 32, 3), dtype=np.float32)


@pytest.fixture(scope="module")
def small_bank() -> Bank:
    plain = patterns.plain(16, np.random.default_rng(0))
    return Bank({name: [plain, IMAGE] if name == "clouds" else [plain] for name in FAMILIES})


def test_bank_returns_what_was_painted(small_bank: Bank) -> None:
    i, j = (a.ravel() for a in np.indices((32, 32)))
    unit = (np.stack([j, i], -1) + 0.5).astype(np.float32) / 32
    pattern, fine = np.full(1024, small_bank.family["clouds"][1]), np.full(1024, 1e-3, np.float32)
    for shift in (0.0, 1.0, -3.0):  # it repeats
        found = small_bank.shares(pattern, unit + np.float32(shift), fine)
        np.testing.assert_allclose(found, IMAGE.reshape(-1, 3), atol=1 / 255 + 1e-4)
    coarse = small_bank.shares(pattern, unit, np.full(1024, 1.0, np.float32))
    np.testing.assert_allclose(coarse, np.broadcast_to(IMAGE.mean((0, 1)), (1024, 3)), atol=0.01)
    half = small_bank.shares(pattern[:1], np.array([[2 / 32, 1 / 32]], np.float32), fine[:1])
    np.testing.assert_allclose(half[0], IMAGE[:2, 1:3].mean((0, 1)), atol=0.005)


def test_looks(small_bank: Bank) -> None:
    """Albedo is one, whatever is drawn; seen from afar it is the mean."""
    looks, rng = Looks(small_bank), np.random.default_rng(1)
    with_plain = [role for role in ROLES if "plain" in ROLES[role].families]
    numbers = np.array([looks.draw(rng, role, 1.0) for role in with_plain for _ in range(10)])
    assert np.array_equal(numbers, np.arange(len(numbers)))
    uv = rng.random((len(numbers), 2), dtype=np.float32)
    near = looks.albedo(numbers, uv, np.full(len(numbers), 0.001, np.float32))
    far = looks.albedo(numbers, uv, np.full(len(numbers), 1e3, np.float32))
    assert near.min() > 0 and near.max() < 1
    np.testing.assert_allclose(far, looks.mean(numbers), atol=0.02)
    assert near.std(axis=0).min() > 0.1  # colours of all kinds


MAKERS = {
    make.__name__: make
    for makers in (pieces.WALL_PIECES, pieces.FREE_PIECES, things.ON_TABLES, things.ON_SHELVES, things.ON_FLOORS)
    for make in makers
}


@pytest.mark.parametrize("name", MAKERS)
def test_pieces_keep_within_their_boxes(name: str, small_bank: Bank) -> None:
    """What is placed without overlap must not stick out of the box it was placed by; things stand on tops of it."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        build = RoomBuilder(rng, Looks(small_bank))
        piece: Furnishing = MAKERS[name](rng)
        tops = piece.add(build)
        made = build.finish()
        corners = made.mesh.vertices[made.mesh.faces].reshape(-1, 3)
        low, high = corners.min(axis=0), corners.max(axis=0)
        half = np.array([piece.wide, piece.deep]) / 2
        slack = max(0.02, 0.04 * piece.wide)
        assert (low[:2] > -half - slack).all() and (high[:2] < half + slack).all(), (seed, low, high)
        assert -0.01 < low[2] < 0.03, (seed, low)  # splayed legs dip in a little
        assert high[2] < piece.tall + slack, (seed, low, high)
        assert np.linalg.norm(made.mesh.vertex_normals[made.mesh.faces], axis=-1).min() > 0.99
        for top in tops:
            assert (np.abs([top.low, top.high]) <= half + slack).all() and 0 < top.z <= piece.tall + slack


# ---- light with known answers: a floor of 4 × 4 m, and perhaps a plate over its left half ----


def floor(plate: bool) -> RayCaster:
    vertices = [[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0], [-2, -2, 1], [0, -2, 1], [0, 2, 1], [-2, 2, 1]]
    faces = [[0, 1, 2], [0, 2, 3]] + [[4, 5, 6], [4, 6, 7]] * plate
    return RayCaster(trimesh.Trimesh(vertices, faces, process=False))


def on_floor(x: np.ndarray) -> Points:
    n = len(x)
    position = np.stack([x, np.zeros(n), np.zeros(n)], -1).astype(np.float32)
    return Points(position, np.tile(np.array([0, 0, 1], np.float32), (n, 1)), np.full(n, 2, np.float32))


X = np.linspace(-1.5, 1.5, 16)
DOWN = np.array([0.0, 0.0, -1.0])


def test_lamp() -> None:
    lamp = RoundLight(np.array([0, 0, 2.0]), 0.0, np.array([3.0, 2.0, 1.0]), DOWN)
    found, toward = light.hard_light(lamp, floor(False), on_floor(X), np.random.default_rng(0))
    far = np.sqrt(4 + X**2)
    np.testing.assert_allclose(found, np.outer(2 / far**3, lamp.color), rtol=1e-4)
    np.testing.assert_allclose(toward[:, 2], 2 / far, rtol=1e-5)
    shaded, _ = light.hard_light(lamp, floor(True), on_floor(X), np.random.default_rng(0))
    np.testing.assert_allclose(shaded[X > 0], found[X > 0])
    assert (shaded[X < 0] == 0).all()


def test_sun_and_cone() -> None:
    sun = RoundLight(np.array([0.6, 0.0, 0.8]), 0.0, np.ones(3), -np.array([0.6, 0.0, 0.8]), sun=True)
    found, _ = light.hard_light(sun, floor(True), on_floor(X), np.random.default_rng(0))
    # The plate's shadow ends where the sun's ray past its edge (0, ·, 1) meets the floor.
    np.testing.assert_allclose(found[:, 0], np.where(X > -0.75, 0.8, 0.0), atol=1e-5)
    spot = RoundLight(np.array([0, 0, 2.0]), 0.0, np.ones(3), DOWN, cosine=float(np.cos(np.radians(20))))
    lit, _ = light.hard_light(spot, floor(False), on_floor(X), np.random.default_rng(0))
    assert (lit[np.abs(X) > 2 * np.tan(np.radians(21)), 0] == 0).all()
    assert (lit[np.abs(X) < 2 * np.tan(np.radians(18)), 0] > 0).all()


def test_panel_is_as_bright_as_its_solid_angle(small_bank: Bank) -> None:
    """A small panel far above gives radiance × area × cosines / distance² / π, its rays averaged over a block."""
    window = RoomWindow(np.array([0, 0, 2.0]), np.array([0.1, 0, 0]), np.array([0, 0.1, 0]), DOWN)
    lighting = Lighting([], [Panel(window, np.array([10.0, 5.0, 0.0]))], np.zeros(3), np.zeros(3))
    looks = Looks(small_bank)
    looks.draw(np.random.default_rng(0), "wall")
    points = on_floor(np.tile(X, 16))
    found = light.soft_light(lighting, floor(False), looks, np.zeros(2, int), points, (16, 16), 0.3)
    expected = 10 * 0.04 / np.pi * 4 / (4 + X**2) ** 2
    np.testing.assert_allclose(found.reshape(16, 16, 3)[..., 0].mean(0), expected, rtol=0.05)
    np.testing.assert_allclose(found[:, 1] * 2, found[:, 0], rtol=1e-5)


def test_open_sky(small_bank: Bank) -> None:
    """Nothing in the way: the same light wherever one stands; under a plate there is less."""
    looks = Looks(small_bank)
    looks.draw(np.random.default_rng(0), "wall")
    lighting = Lighting([], [], np.ones(3), np.zeros(3))
    points = on_floor(np.tile(X, 16))

    def sky(plate: bool) -> np.ndarray:
        return light.soft_light(lighting, floor(plate), looks, np.zeros(4, int), points, (16, 16), 0.1)

    bare = light.smooth(sky(False), points, (16, 16))
    assert bare.std() < 0.05 * bare.mean()
    covered = sky(True).reshape(16, 16, 3).mean((0, 2))
    assert covered[X < -0.5].max() < 0.9 * bare.mean()


def test_smoothing_stops_at_borders() -> None:
    """Light of two floors, one a metre below the other, is averaged on each and never mixed."""
    n = 16
    step = np.where(np.arange(n) < n // 2, 0.0, -1.0)
    position = np.zeros((n, n, 3), np.float32)
    position[..., 0], position[..., 2] = np.arange(n) * 0.01, step
    points = Points(position.reshape(-1, 3), np.tile(np.float32([0, 0, 1]), (n * n, 1)), np.ones(n * n, np.float32))
    noisy = (step + 2 + 0.1 * np.random.default_rng(0).standard_normal((n, n)))[..., None].repeat(3, -1)
    found = light.smooth(noisy.reshape(-1, 3).astype(np.float32), points, (n, n)).reshape(n, n, 3)
    assert np.abs(found[..., 0] - (step + 2)).max() < 0.12
    assert (found[..., 0] - (step + 2)).std() < 0.4 * 0.1


@given(st.integers(0, 1 << 30))
def test_camera(seed: int) -> None:
    """8-bit steps in [0, 1], exposed so that there is something to see, whatever the light."""
    rng = np.random.default_rng(seed)
    linear = (10 ** rng.uniform(-3, 3) * rng.random((24, 40, 3))).astype(np.float32)
    shot = exposure.develop(linear, rng)
    assert shot.shape == linear.shape and shot.dtype == np.float32
    assert shot.min() >= 0 and shot.max() <= 1
    np.testing.assert_allclose(shot * 255, np.round(shot * 255), atol=1e-4)
    assert 0.15 < shot.mean() < 0.85


def test_compression_rounds_as_it_should() -> None:
    image = np.random.default_rng(0).random((20, 28, 3)).astype(np.float32)
    np.testing.assert_allclose(exposure._compressed(image, 1e-4), image, atol=4 / 255)  # of 8 bits, in YCbCr
    coarse = exposure._compressed(image, 3.0)
    assert 0.02 < np.abs(coarse - image).mean() < 0.4
    flat = np.full((16, 16, 3), 0.5, np.float32)
    assert exposure._compressed(flat, 1.0).std(axis=(0, 1)).max() < 1e-6  # no pattern where there was none
