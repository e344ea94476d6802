"""Illuminance of every kind of light against closed forms, conservation of flux, and gradients."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference.differences import assert_gradients

import hyjax
from hyjax import (
    AmbientLight,
    DirectionalLight,
    GBuffer,
    InputError,
    Light,
    PointLight,
    RectLight,
    SkyLight,
    SpotLight,
    shade,
    shade_each,
)

WHITE = np.ones(3)
POINT = PointLight(np.array([0.2, -0.1, 1.5]), np.float64(800.0), np.array([1.0, 0.5, 0.25]), np.float64(0.0))
SPOT = SpotLight(
    POINT.position,
    np.array([0.1, 0.3, -2.0]),
    POINT.luminous_flux,
    WHITE,
    np.float64(0.3),
    np.float64(0.9),
    POINT.radius,
)
SUN = DirectionalLight(np.array([1.0, 2.0, -2.0]), np.float64(5e4), WHITE, np.float64(0.0047))
RECT = RectLight(
    np.array([0.1, 0.2, 2.0]), np.array([0.0, 0.7, 0.1]), np.array([0.4, 0.0, 0.0]), np.float64(600.0), WHITE
)
SKY = SkyLight(np.array([0.0, 0.0, 3.0]), np.float64(1e4), WHITE)
AMBIENT = AmbientLight(np.float64(100.0), np.array([1.0, 0.8, 0.6]))
ALL = [POINT, SPOT, SUN, RECT, SKY, AMBIENT]
UP = np.array([0.0, 0.0, 1.0])


def in_color(light: Light, p: jax.Array, n: jax.Array) -> jax.Array:
    """Illuminance for red, green and blue."""
    return light.illuminance_at(p, n)[..., None] * light.color


def illuminance(light: Light, p: np.ndarray, n: np.ndarray) -> np.ndarray:
    """In colour and in float64. One compilation for each kind and shape."""
    with jax.enable_x64(True):
        arrays = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), light)
        p, n = np.broadcast_arrays(p, n)
        return np.asarray(jax.jit(in_color)(arrays, jnp.asarray(p, jnp.float64), jnp.asarray(n, jnp.float64)))


def random_units(rng: np.random.Generator, count: int) -> np.ndarray:
    v = rng.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def test_point_over_a_plane() -> None:
    """E = Φ/4π · h / (h² + d²)^{3/2}, in colour, and nothing from behind."""
    d = np.linspace(0.0, 5.0, 16)
    p = POINT.position + np.stack([d, 0 * d, 0 * d - 1.3], axis=-1)
    expected = 800.0 / (4 * np.pi) * 1.3 / (1.3**2 + d**2) ** 1.5
    np.testing.assert_allclose(illuminance(POINT, p, UP), expected[:, None] * POINT.color, rtol=1e-9)
    assert np.all(illuminance(POINT, p, -UP) == 0)


def test_spot_profile() -> None:
    """Full inside the inner cone, dark outside the outer, half of the peak at the mean of the two cosines."""
    axis = SPOT.direction / np.linalg.norm(SPOT.direction)
    side = np.cross(axis, UP) / np.linalg.norm(np.cross(axis, UP))
    middle = np.arccos(0.5 * (np.cos(0.3) + np.cos(0.9)))
    angles = np.array([0.0, 0.299, middle, 0.901, 1.5, 3.0])
    ways = np.cos(angles)[:, None] * axis + np.sin(angles)[:, None] * side
    got = illuminance(SPOT, SPOT.position + 2.0 * ways, -ways)[:, 0]
    np.testing.assert_allclose(got / got[0], [1.0, 1.0, 0.5, 0.0, 0.0, 0.0], atol=1e-9)


def test_sun_sky_and_ambient() -> None:
    n = random_units(np.random.default_rng(0), 16)
    p = np.random.default_rng(1).normal(size=(16, 3))
    cosine = -(n @ SUN.direction) / 3.0
    np.testing.assert_allclose(illuminance(SUN, p, n)[:, 0], 5e4 * np.maximum(cosine, 0.0), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(illuminance(SKY, p, n)[:, 1], 1e4 * 0.5 * (1 + n[:, 2]), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(illuminance(AMBIENT, p, n), np.tile(100.0 * AMBIENT.color, (16, 1)), rtol=1e-12)


def test_sky_is_the_sum_of_its_directions() -> None:
    """(1 + n·up)/2 against an integral over the dome of uniform radiance L = E₀/π."""
    rng = np.random.default_rng(0)
    dome = random_units(rng, 200_000)
    dome[:, 2] = np.abs(dome[:, 2])
    n = random_units(rng, 6)
    integral = 2 * np.pi * np.maximum(dome @ n.T, 0.0).mean(axis=0) * 1e4 / np.pi
    np.testing.assert_allclose(illuminance(SKY, np.zeros(3), n)[:, 0], integral, rtol=0.01, atol=20.0)


def fibonacci(count: int) -> np.ndarray:
    k = np.arange(count)
    z, angle = 1 - (2 * k + 1) / count, k * np.pi * (3 - np.sqrt(5))
    return np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], axis=-1)


@pytest.mark.parametrize("light", [POINT, SPOT, dataclasses.replace(SPOT, outer_angle=np.float64(3.0)), RECT])
def test_all_the_power_arrives(light: Light) -> None:
    """The flux through a sphere around a lamp is its power, whatever its kind and wherever in the sphere it is."""
    ways = fibonacci(200_000)
    flux = 4 * np.pi * 3.0**2 * illuminance(light, 3.0 * ways, -ways).mean(axis=0)
    color = np.asarray(light.color)
    np.testing.assert_allclose(flux, float(light.luminous_flux) * color, rtol=2e-3)


def rectangle_over(a: float, b: float, c: float) -> RectLight:
    """Rectangle [0, a] × [0, b] at height c, shining down on the origin. Φ = A makes E the form factor."""
    half = np.array([a, b]) / 2
    return RectLight(
        np.array([*half, c]), np.array([0, half[1], 0.0]), np.array([half[0], 0, 0.0]), np.float64(a * b), WHITE
    )


lengths = st.floats(0.05, 20.0)


@given(lengths, lengths, lengths)
def test_rect_parallel_form_factor(a: float, b: float, c: float) -> None:
    """Differential area parallel to a rectangle with a corner above it (Howell's catalogue, B-3)."""
    x, y = a / c, b / c
    expected = (
        x / np.hypot(1, x) * np.arctan(y / np.hypot(1, x)) + y / np.hypot(1, y) * np.arctan(x / np.hypot(1, y))
    ) / (2 * np.pi)
    np.testing.assert_allclose(illuminance(rectangle_over(a, b, c), np.zeros(3), UP)[0], expected, rtol=1e-7)


@given(lengths, lengths, lengths)
def test_rect_perpendicular_form_factor(a: float, b: float, c: float) -> None:
    """Differential area perpendicular to a rectangle, its normal along a side (B-4): F = (atan 1/Y − …)/2π."""
    x, y = a / b, c / b
    root = np.hypot(x, y)
    expected = (np.arctan(1 / y) - y / root * np.arctan(1 / root)) / (2 * np.pi)
    got = illuminance(rectangle_over(a, b, c), np.zeros(3), np.array([1.0, 0.0, 0.0]))[0]
    np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-12)


def test_rect_by_monte_carlo_partly_below_the_horizon() -> None:
    rng = np.random.default_rng(0)
    s, t = rng.uniform(-1, 1, (2, 400_000, 1))
    samples = RECT.center + s * RECT.right + t * RECT.up
    normal = np.cross(RECT.right, RECT.up)
    area = 4 * np.linalg.norm(normal)
    normal /= np.linalg.norm(normal)
    partly = whole = 0
    for _ in range(24):
        p = RECT.center + rng.normal(size=3)
        p -= max(0.0, 0.2 - (p - RECT.center) @ normal) * -normal
        n = random_units(rng, 1)[0]
        to = samples - p
        r = np.linalg.norm(to, axis=-1)
        cosines = np.maximum(to @ n / r, 0) * np.maximum(-(to @ normal) / r, 0)
        expected = RECT.luminous_flux / np.pi * np.mean(cosines / r**2)
        share = np.mean(to @ n > 0)
        partly, whole = partly + (0 < share < 1), whole + (share == 1)
        np.testing.assert_allclose(
            illuminance(RECT, p, n)[0], expected, rtol=0.02, atol=1e-3 * RECT.luminous_flux / area
        )
    assert partly >= 4 and whole >= 4  # the seed covers both


@pytest.mark.parametrize("light", ALL, ids=lambda light: type(light).__name__)
def test_gradients(light: Light) -> None:
    """Of the illuminance with respect to every parameter and to where and how the surface stands."""
    p = np.array([[0.3, 0.2, 0.0], [-0.5, 0.4, 0.1], [0.1, 0.0, 0.3]])
    n = np.array([[0.1, -0.2, 0.97], [0.95, 0.3, 0.1], [-0.3, -0.3, 0.9]])
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    scale = 1.0 / illuminance(light, p, n).max()
    parameters = {f.name: getattr(light, f.name) for f in dataclasses.fields(light)}
    parameters = {
        k: v for k, v in parameters.items() if k not in ("radius", "clearance", "angular_radius")
    }  # shadows only

    def loss(parameters: dict, n: jax.Array) -> jax.Array:
        return scale * jnp.sum(in_color(dataclasses.replace(light, **parameters), p, n) * jnp.arange(1.0, 4.0))

    with jax.enable_x64(True):
        if isinstance(light, AmbientLight):
            assert_gradients(lambda q: loss(q, n), parameters)
        else:
            assert_gradients(loss, parameters, n, rtol=1e-4)


def degenerate() -> list[tuple[np.ndarray, np.ndarray]]:
    """Places where a formula divides by zero if it can: on the lamp, in its plane, on its edges, behind it."""
    corner, edge = RECT.center + RECT.right + RECT.up, RECT.center + RECT.right
    outside = RECT.center + 3 * RECT.right
    places = [POINT.position, RECT.center, corner, edge, outside, RECT.center + UP, RECT.center - UP, np.zeros(3)]
    normal = np.cross(RECT.right, RECT.up) / np.linalg.norm(np.cross(RECT.right, RECT.up))
    return [(p, n) for p in places for n in (UP, -UP, normal, -normal, np.array([1.0, 0, 0]), np.zeros(3))]


@pytest.mark.parametrize("light", ALL, ids=lambda light: type(light).__name__)
def test_degenerate_places_are_finite(light: Light) -> None:
    """Values are finite and ≥ 0 and no gradient is NaN; a missed pixel is zero in position and normal."""
    arrays = jax.tree.map(lambda leaf: jnp.asarray(leaf, np.float32), light)
    p, n = (jnp.asarray(np.stack(a), np.float32) for a in zip(*degenerate(), strict=True))
    values = np.asarray(jax.jit(in_color)(arrays, p, n))
    assert np.all(np.isfinite(values)) and np.all(values >= 0)
    gradient = jax.jit(jax.grad(lambda *a: in_color(*a).sum(), argnums=(0, 1, 2)))
    for leaf in jax.tree.leaves(gradient(arrays, p, n)[0]):
        assert np.all(np.isfinite(leaf))
    for leaf in gradient(arrays, p, n)[1:]:
        bad = ~np.isfinite(np.asarray(leaf)).all(axis=1)
        assert not bad.any(), f"gradient is not finite at {[degenerate()[k] for k in np.flatnonzero(bad)]}"


def test_rect_does_not_shine_backwards_and_touching_is_full() -> None:
    normal = np.cross(RECT.right, RECT.up) / np.linalg.norm(np.cross(RECT.right, RECT.up))
    assert np.all(illuminance(RECT, RECT.center - 0.5 * normal, normal) == 0)
    radiosity = RECT.luminous_flux / (4 * np.linalg.norm(np.cross(RECT.right, RECT.up)))
    np.testing.assert_allclose(illuminance(RECT, RECT.center + 1e-4 * normal, -normal)[0], radiosity, rtol=1e-3)


def test_shade_adds_up_and_leaves_misses_dark() -> None:
    rng = np.random.default_rng(0)
    hit = rng.uniform(size=(5, 7)) > 0.3
    position, normal = (
        rng.normal(size=(5, 7, 3)) * hit[..., None],
        random_units(rng, 35).reshape(5, 7, 3) * hit[..., None],
    )
    gbuffer = GBuffer(
        *(jnp.asarray(a) for a in (position.astype(np.float32), normal.astype(np.float32), hit * 1.0, hit))
    )
    lights = [jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), light) for light in ALL]
    each, total = np.asarray(shade_each(gbuffer, lights)), np.asarray(shade(gbuffer, lights))
    assert each.shape == (5, 7, 6)
    np.testing.assert_allclose(total, each @ np.stack([np.asarray(light.color) for light in ALL]), rtol=1e-5)
    assert np.all(total[~hit] == 0) and np.all(total[hit] > 0)
    for k, light in enumerate(ALL):
        expected = illuminance(light, position, normal)[hit][:, 0] / light.color[0]
        np.testing.assert_allclose(each[hit][:, k], expected, rtol=2e-3, atol=1.0)
    with pytest.raises(InputError, match=r"^lights: none given; give at least one$"):
        shade(gbuffer, [])


def test_a_set_up_is_an_argument_of_a_jitted_function() -> None:
    """And has gradients: of strength and reference alike."""
    position = jnp.zeros((2, 2, 3)).at[..., 0].set(jnp.arange(4.0).reshape(2, 2))
    normal, ones = jnp.zeros((2, 2, 3)).at[..., 2].set(1.0), jnp.ones((2, 2))
    view = hyjax.View.of(jnp.full((2, 2, 3), 0.5), hyjax.GBuffer(position, normal, ones, ones > 0))
    lamp = hyjax.PointLight(jnp.array([0.0, 0.0, 2.0]), jnp.asarray(800.0), jnp.ones(3))

    def brightness(setup: hyjax.LightSetup) -> jax.Array:
        shaded = view.shade(setup)
        return jnp.mean(shaded.illuminance) / shaded.reference_lux

    setup = hyjax.LightSetup((lamp,), 200.0)
    value, slope = jax.jit(jax.value_and_grad(brightness))(setup)
    np.testing.assert_allclose(value, brightness(setup), rtol=1e-5)
    np.testing.assert_allclose(slope.lights[0].luminous_flux, value / 800.0, rtol=1e-4)
    np.testing.assert_allclose(slope.reference_lux, -value / 200.0, rtol=1e-4)
