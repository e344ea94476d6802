"""Fit of the photo's light: a room whose light is known, and rooms that tell nothing."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from hyjax.data.capture import Frame
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.transport_rays import enclose, trace
from hyjax.light.transport import Transport, bounce, gather, send
from hyjax.photo_light import fit
from hyjax.photo_light.basis import BINS, make_basis, window_light
from hyjax.photo_light.belief import EXPONENTS, FOLD_COUNT, LARGEST_SIDE, LEAST_SHARE, best, flatness, folds
from hyjax.photo_light.estimate import estimate_arrays, read_estimate
from hyjax.photo_light.fit import FitProblem, fit_sources, high_quantile, illuminance, loss
from hyjax.photo_light.pairs import coplanar_pairs
from hyjax.photo_light.radiance import linear, vertex_radiance
from hyjax.photo_light.sources import PhotoLamp, PhotoSources, PhotoWindow

UP = np.array([0.0, 0.0, 1.0])
WINDOW = PhotoWindow.facing("window-1", np.array([2.0, 0.0, 0.2]), np.array([-1.0, 0.0, 0.0]), UP, 1.8, 1.2)
SOURCES = PhotoSources((WINDOW,), (), "file")
LENS = Intrinsics(96, 72, 50.0, 50.0, 48.0, 36.0)


def room() -> trimesh.Trimesh:
    """A box of 4 × 3 × 2.5 m seen from inside, without the triangles of its window."""
    mesh = trimesh.creation.box((4.0, 3.0, 2.5)).subdivide_to_size(0.25)
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=True)
    away = mesh.triangles_center - WINDOW.center
    opening = (np.abs(away[:, 0]) < 0.05) & (np.abs(away[:, 1]) < 0.9) & (np.abs(away[:, 2]) < 0.6)
    mesh.update_faces(~opening)
    mesh.remove_unreferenced_vertices()
    return mesh


class Lit:
    """The room with a known light: light of the window, its bounces, and what surfaces then send."""

    def __init__(self) -> None:
        rng, self.mesh = np.random.default_rng(0), room()
        self.caster, self.count = RayCaster(self.mesh), len(self.mesh.vertices)
        hits, position, normal = trace(self.caster, enclose(self.caster, UP), [WINDOW.aperture], rays=128)
        self.position, self.normal = position, normal
        self.basis = make_basis(self.caster, hits, position, normal, SOURCES, UP)
        place, facing = (jnp.asarray(a, jnp.float32) for a in (position, normal))
        self.transport = Transport(
            jnp.asarray(hits), jnp.asarray(self.mesh.faces, jnp.int32), place, facing, self.count
        )
        theta = np.zeros((self.basis.light.shape[1], 3))
        theta[: BINS[0] * BINS[1]] = rng.uniform(0.5, 30.0, (BINS[0] * BINS[1], 1)) * [1.0, 0.9, 0.7]
        # Walls of an albedo each, with stripes.
        wall = np.argmax(np.abs(normal), axis=1) * 2 + (normal.sum(axis=1) > 0)
        albedo = rng.uniform(0.35, 0.85, (6, 3))[wall]
        albedo[np.floor(position.sum(axis=1) / 0.7).astype(int) % 4 == 0] *= 0.6
        direct = jnp.asarray(self.basis.light @ theta, jnp.float32)
        # The truth goes along other rays, and more of them, than those of the fit.
        other, _, _ = trace(self.caster, enclose(self.caster, UP), [WINDOW.aperture], rays=512, seed=7)
        true = dataclasses.replace(self.transport, hits=jnp.asarray(other))
        self.light = np.asarray(direct + bounce(true, jnp.asarray(albedo, jnp.float32), direct, 12))
        self.radiance = albedo[: self.count] * self.light[: self.count]

    def problem(self) -> FitProblem:
        radiance = self.radiance / np.exp(np.log(self.radiance).mean())
        sent = np.concatenate([radiance, np.zeros((len(self.position) - self.count, 3))])
        gathered = gather(self.transport.hits, send(self.transport, jnp.asarray(sent, jnp.float32)))
        seen = np.ones(self.count, bool)
        pairs = coplanar_pairs(self.position[: self.count], self.normal[: self.count], seen, 6000)
        floats = (gathered[: self.count], self.basis.light[: self.count], np.log(radiance))
        light, basis, c = (jnp.asarray(a, jnp.float32).T for a in floats)
        alike, chosen = (jnp.asarray(a, jnp.int32) for a in (self.basis.neighbours, pairs))
        return FitProblem(light, basis, c, jnp.asarray(seen), chosen, jnp.ones(len(pairs), bool), alike)


@pytest.fixture(scope="module")
def lit() -> Lit:
    return Lit()


def spread(log: np.ndarray) -> float:
    """Median distance of logarithms from their median."""
    return float(np.median(np.abs(log - np.median(log, axis=0))))


def test_the_light_of_a_known_room_is_found(lit: Lit) -> None:
    problem = lit.problem()
    found = np.asarray(illuminance(problem, jnp.asarray(fit_sources(problem), jnp.float32))).T
    true = lit.light[: lit.count]
    assert spread(np.log(found / true)) < 0.3 * spread(np.log(true))
    assert spread(np.log(found / true)) < 0.08


def test_rounding_does_not_end_the_fit(lit: Lit, monkeypatch: pytest.MonkeyPatch) -> None:
    """The loss goes on falling where single precision sees none of it, with gradients of other rounding, too."""
    problem, value_and_gradient = lit.problem(), fit._value_and_gradient
    rng, values = np.random.default_rng(0), list[float]()

    def rounded(*arguments: Any) -> Any:
        value, slope = value_and_gradient(*arguments)
        values.append(float(value))
        return value, slope * (1 + 1e-6 * rng.standard_normal(slope.shape))

    monkeypatch.setattr(fit, "_value_and_gradient", rounded)
    fit_sources(problem)
    assert len(values) >= fit.ITERATIONS, "none of them ended it"
    assert np.any(np.float64(values) != np.float32(values)), "sums have double precision"


def test_the_gradient_of_the_fit_is_that_of_finite_differences(lit: Lit) -> None:
    problem = lit.problem()
    rng = np.random.default_rng(0)
    with jax.enable_x64(True):
        double = jax.tree.map(
            lambda x: jnp.asarray(x, jnp.float64) if jnp.issubdtype(x.dtype, jnp.floating) else x, problem
        )
        start, way = (jnp.asarray(rng.normal(size=(3, len(problem.basis)))) for _ in range(2))
        slope = jnp.sum(jax.grad(loss)(start, double) * way)
        step = 1e-6
        numeric = (loss(start + step * way, double) - loss(start - step * way, double)) / (2 * step)
    np.testing.assert_allclose(slope, numeric, rtol=1e-4)


@given(st.sampled_from([1, 2, 21, 60]), st.integers(0, 2**32 - 1))
def test_the_high_quantile_is_numpys(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 9, (count, 3)) + rng.choice([0.0, 0.25], (count, 3))  # with ties
    chosen = rng.random(count) < rng.choice([0.1, 0.6, 1.0])
    chosen[rng.integers(count)] = True
    found = high_quantile(jnp.asarray(values.T, jnp.float32), jnp.asarray(chosen), 0.95)
    np.testing.assert_allclose(found, np.quantile(values[chosen], 0.95, axis=0), atol=1e-5)


def test_a_window_lights_what_faces_it(lit: Lit) -> None:
    light = lit.basis.light[: lit.count, : BINS[0] * BINS[1]].sum(axis=1)
    beside = lit.position[: lit.count, 0] > 1.99
    # Of radiance times π one it throws its form factor, at most 1; its own wall gets nothing.
    assert light.min() >= 0 and light.max() < 1
    assert light[beside & (np.abs(lit.position[: lit.count, 1]) < 1.4)].max() < 0.05


def test_a_window_lights_by_its_form_factor(lit: Lit) -> None:
    """Four quarters, each seen from its corner (Howell, catalog of configuration factors, B-4)."""
    distance, a, b = 1.5, 0.9, 0.6
    point, facing = np.array([[2.0 - distance, 0.0, 0.2]]), np.array([[1.0, 0.0, 0.0]])
    x, y = a / distance, b / distance
    u, v = np.sqrt(1 + x * x), np.sqrt(1 + y * y)
    quarter = (x / u * np.arctan(y / u) + y / v * np.arctan(x / v)) / (2 * np.pi)
    found = window_light(lit.caster, point, facing, WINDOW.aperture).sum()
    assert found == pytest.approx(4 * quarter, rel=0.01)


@pytest.mark.parametrize(("height", "shapes"), [(0.5, 1), (1.02, 2)])
def test_a_lamp_throws_its_light_by_the_inverse_square(height: float, shapes: int, lit: Lit) -> None:
    """Of the ceiling, downwards by the cosine, too."""
    place = np.array([0.0, 0.0, height])
    sources = PhotoSources((), (PhotoLamp("lamp-1", place, 0.05),), "file")
    hits = np.asarray(lit.transport.hits)
    basis = make_basis(lit.caster, hits, lit.position, lit.normal, sources, UP)
    to = place - lit.position[: lit.count]
    distance = np.linalg.norm(to, axis=1)
    around = np.maximum(np.einsum("nk,nk->n", to, lit.normal[: lit.count]), 0) / distance**3
    down = around * 2 * np.maximum(to[:, 2], 0) / distance
    assert basis.names[0] == "lamp-1" and (basis.source == 0).sum() == shapes
    for column, expected in zip(basis.light[: lit.count, :shapes].T, (around, down), strict=False):
        assert (np.abs(column - expected) < 0.02 * expected + 0.01).mean() > 0.98


def test_pairs_lie_on_one_plane_and_blocks_are_held_out_whole(lit: Lit) -> None:
    position, normal = lit.position[: lit.count], lit.normal[: lit.count]
    pairs = coplanar_pairs(position, normal, np.ones(lit.count, bool), 3000)
    away = position[pairs[:, 1]] - position[pairs[:, 0]]
    assert len(pairs) > 1000
    assert np.abs(np.einsum("nk,nk->n", away, normal[pairs[:, 0]])).max() < 0.05
    for scale in (1.0, 0.3):  # the corner of a room needs smaller blocks than all of it
        first = scale * position[pairs[:, 0]]
        fold = folds(first)
        assert np.bincount(fold, minlength=FOLD_COUNT).min() >= LEAST_SHARE * len(pairs)
        if scale == 1.0:
            _, block = np.unique(np.floor(first / LARGEST_SIDE).astype(int), axis=0, return_inverse=True)
            assert all(len(set(fold[block.reshape(-1) == n])) == 1 for n in range(block.max() + 1))


def frames_of(lit: Lit, gains: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)) -> list[Frame]:
    """Pictures of the room, each with an exposure of its own."""
    found = []
    for k, gain in enumerate(gains):
        angle = 2 * np.pi * k / len(gains)
        eye = 0.6 * np.array([np.cos(angle), np.sin(angle), 0.0])
        camera = Camera(LENS, look_at(eye, eye + np.array([np.cos(angle), np.sin(angle), -0.15]), UP))
        hits = lit.caster.cast(camera.origin, camera.rays().reshape(-1, 3))
        corners = np.asarray(lit.mesh.faces)[np.maximum(hits.face, 0)]
        seen = np.einsum("nk,nkc->nc", hits.barycentric, lit.radiance[corners]) * hits.hit[:, None]
        value = np.clip(gain * seen / np.quantile(lit.radiance, 0.98) * 0.8, 0, 1)
        encoded = np.where(value <= 0.0031308, 12.92 * value, 1.055 * np.maximum(value, 1e-9) ** (1 / 2.4) - 0.055)
        found.append(Frame(f"f{k}", encoded.reshape(*LENS.shape, 3).astype(np.float32), camera, float(k)))
    return found


def test_radiance_is_read_from_frames_of_different_exposure(lit: Lit) -> None:
    found = vertex_radiance(lit.caster, frames_of(lit, (0.7, 1.0, 0.5, 1.0, 0.8, 0.6)))
    clear = (found.weight > 0.5) & (found.radiance.max(axis=1) < 0.7)
    assert clear.mean() > 0.3
    assert spread(np.log(found.radiance[clear] / lit.radiance[clear])) < 0.08


def test_a_black_margin_of_pictures_tells_no_radiance(lit: Lit) -> None:
    frames = frames_of(lit)
    plain = vertex_radiance(lit.caster, frames)
    for frame in frames:
        frame.image[:3] = frame.image[-3:] = frame.image[:, :3] = frame.image[:, -3:] = 0.0
    found = vertex_radiance(lit.caster, frames)
    both = found.weight > 0
    assert 0.5 < both.sum() / (plain.weight > 0).sum() < 1.0
    assert (found.radiance[both & (plain.weight == found.weight)] > 0).any(axis=1).all()
    assert np.median(np.abs(np.log(found.radiance[both].mean(axis=1) / plain.radiance[both].mean(axis=1)))) < 0.02


def test_a_broken_picture_takes_nothing_from_the_others(lit: Lit) -> None:
    frames = frames_of(lit)
    want = vertex_radiance(lit.caster, frames[:-1])
    frames[-1].image[:] = np.nan
    found = vertex_radiance(lit.caster, frames)
    np.testing.assert_allclose(found.radiance, want.radiance, rtol=1e-6)
    np.testing.assert_allclose(found.weight, want.weight, rtol=1e-6)


def test_display_values_are_decoded() -> None:
    np.testing.assert_allclose(linear(np.array([0.0, 0.04, 0.5, 1.0])), [0.0, 0.003096, 0.214041, 1.2], atol=1e-5)


def test_an_estimate_comes_back_from_its_arrays(lit: Lit) -> None:
    arrays = estimate_arrays(lit.caster, frames_of(lit), UP, SOURCES)
    found = read_estimate(lit.caster, arrays)
    assert found.names == ("window-1", "walls", "floor", "ceiling")
    assert found.exponent > 0 and min(found.flatness) < 0.9
    # Shares of the sources add up to all the light.
    np.testing.assert_allclose(found.light.sources.sum(axis=0), found.light.illuminance, rtol=1e-3)
    # It comes nearer to the truth than an even light.
    true = lit.light[: lit.count]
    assert spread(np.log(np.asarray(found.light.illuminance) / true)) < 0.6 * spread(np.log(true))


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_black_or_burnt_out_frames_leave_the_light_even(lit: Lit, value: float) -> None:
    frames = [
        Frame(frame.name, np.full_like(frame.image, value), frame.camera, frame.time) for frame in frames_of(lit)
    ]
    found = read_estimate(lit.caster, estimate_arrays(lit.caster, frames, UP, SOURCES))
    assert found.exponent == 0 and found.reason
    np.testing.assert_allclose(found.light.illuminance, 1.0, rtol=1e-5)


def test_a_scan_of_three_triangles_leaves_the_light_even(lit: Lit) -> None:
    mesh = trimesh.Trimesh(lit.mesh.vertices, lit.mesh.faces[:3], process=True)
    caster = RayCaster(mesh)
    found = read_estimate(caster, estimate_arrays(caster, frames_of(lit), UP, SOURCES))
    assert found.exponent == 0 and np.isfinite(np.asarray(found.light.illuminance)).all()
    assert "too little" in found.reason


def scans(count: int, gain: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Flatness and its covariance of scans of so many blocks with ten pairs each, alike within a block."""
    rng, block, found = np.random.default_rng(0), np.repeat(np.arange(count), 10), []
    for _ in range(200):
        before = rng.gamma(4.0, size=10 * count)
        alike = rng.normal(1 - gain, 0.3, count)[block]
        after = before * np.maximum(alike + 0.1 * rng.normal(size=10 * count), 0.0)
        weight = np.array(EXPONENTS)
        found.append(flatness(before[:, None] * (1 - weight) + after[:, None] * weight, block))
    return found


def test_the_error_of_flatness_is_its_spread_over_scans() -> None:
    drawn = scans(40, gain=0.2)
    spread_of = np.std([found for found, _ in drawn], axis=0)
    told = np.mean([np.diagonal(covariance) ** 0.5 for _, covariance in drawn], axis=0)
    np.testing.assert_allclose(told[1:], spread_of[1:], rtol=0.15)
    assert told[0] == 0 and spread_of[-1] > 0.04  # ten times more pairs than blocks would tell a third of that


def test_little_evidence_is_not_believed_where_much_is() -> None:
    few, many = (np.mean([best(*one) > 0 for one in scans(count, gain=0.1)]) for count in (8, 400))
    assert few < 0.4 and many == 1.0
    assert best(np.array([1.0, 0.9, 0.8, 0.7, 0.6]), np.full((5, 5), np.inf)) == 0.0


def test_of_exponents_that_flatten_alike_the_smallest_is_taken() -> None:
    """Alike is what differs by no more than the standard error of that difference, which is paired."""
    found, apart = np.array([1.0, 0.95, 0.91, 0.902, 0.9]), np.array([0.1, 0.08, 0.04, 0.01, 0.0])
    for scale, exponent in ((0.0, 1.0), (0.19, 1.0), (0.21, 0.75), (0.3, 0.5)):
        by_exponent = scale * apart
        assert best(found, np.outer(by_exponent[0] - by_exponent, by_exponent[0] - by_exponent)) == exponent
    apart = np.array([0.0, 0.004, 0.01, 0.015, 0.02])
    assert best(np.array([1.0, 0.97, 0.955, 0.954, 0.95]), np.outer(apart, apart)) == 0.5  # 0.25 gains too little
