"""Guides for inference: batch norms, parities and κ folded in, any size of picture, files that make no guide."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import safetensors.numpy
from flax import nnx
from test_guide_weights import Toy

from hyjax.configuration import GuideOptions
from hyjax.core.diffusion import conductance
from hyjax.core.pyramid import downsample
from hyjax.core.schedule import DEFAULT_KAPPA
from hyjax.guide import ENCODERS, Guide, GuideNetwork, load_guide, normalise, save_guide
from hyjax.guide.choose import ReducedGuide, configured_guide, open_guide
from hyjax.guide.inference import fold
from hyjax.guide.layers import ConvNorm
from hyjax.guide.weights import named_variables
from hyjax.util.errors import InputError


@pytest.fixture(autouse=True)
def toy_encoder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ENCODERS, "toy", Toy)


@pytest.fixture(scope="module")
def network() -> GuideNetwork:
    """Ready for inference, with statistics of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(ENCODERS, "toy", Toy)
        network = GuideNetwork("toy", 5, rngs=nnx.Rngs(0))
    rng = np.random.default_rng(0)
    for name, variable in named_variables(network).items():
        if "weight" not in name or variable.ndim == 1:
            variable.set_value(jnp.asarray(rng.uniform(0.5, 1.5, variable.shape), jnp.float32))
    network.eval()
    return network


def picture(height: int = 20, width: int = 24) -> jax.Array:
    return jnp.asarray(np.random.default_rng(1).random((height, width, 3), np.float32))


@pytest.mark.parametrize("size", [(20, 24), (32, 64)])
def test_folding_changes_features_by_a_constant(network: GuideNetwork, size: tuple[int, int]) -> None:
    folded = fold(network, kappa=2 * DEFAULT_KAPPA)
    assert not [m for _, m in nnx.iter_modules(folded) if isinstance(m, nnx.BatchNorm)]
    assert [m for _, m in nnx.iter_modules(network) if isinstance(m, nnx.BatchNorm)], "the original was changed"
    images = normalise(picture(*size))[None]
    bias = network.segmentation_head[0].bias[...]
    assert float(jnp.abs(bias).min()) > 0.1
    np.testing.assert_allclose(2 * folded(images) + bias, network(images), rtol=1e-4, atol=1e-5)


def test_kappa_is_folded_in(network: GuideNetwork, tmp_path: Path) -> None:
    """Whatever κ a network was trained with, its guide has the same conductances under the usual one."""
    path = tmp_path / "x.safetensors"
    save_guide(path, network, kappa=0.7, dtype="float32")
    features = network(normalise(picture())[None])[0]
    expected = conductance(features, 0.7)
    guide = load_guide(path)
    for ours, theirs in zip(conductance(guide.features(picture()), DEFAULT_KAPPA), expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("size", [(16, 16), (17, 31), (1, 1)])
def test_any_size(network: GuideNetwork, size: tuple[int, int]) -> None:
    features = Guide(network).features(picture(*size))
    assert features.shape == (*size, 5) and np.isfinite(features).all()


def test_a_reduced_guide_is_that_of_the_frame_at_half_its_size(network: GuideNetwork) -> None:
    """Of odd sizes too."""
    guide = Guide(network, name="toy", fingerprint="1")
    reduced = ReducedGuide(guide)
    assert (reduced.name, reduced.fingerprint) == ("toy-half", "1-half")
    small = guide.features(picture())
    features = reduced.features(jnp.repeat(jnp.repeat(picture(), 2, axis=0), 2, axis=1))
    np.testing.assert_allclose(downsample(features, 2)[1:-1, 1:-1], bilinear_mean(small), atol=1e-5)
    assert reduced.features(picture(17, 31)).shape == (17, 31, 5)


def bilinear_mean(cells: jax.Array) -> jax.Array:
    """Means over the inner cells of what is bilinear between their centres."""
    for axis in (0, 1):
        n = cells.shape[axis]
        before, own, after = (jax.lax.slice_in_dim(cells, k, n - 2 + k, axis=axis) for k in range(3))
        cells = (before + 6 * own + after) / 8
    return cells


def test_shipped_guides_by_name() -> None:
    small, half = open_guide("small"), open_guide("small-half")
    assert half.name == "small-half" and isinstance(half, ReducedGuide) and half.guide.name == "small"
    assert half.fingerprint == f"{small.fingerprint}-half"
    with pytest.raises(InputError, match="one of rgb, none, small, small-half"):
        open_guide("small-hal")


def test_a_file_that_is_written_again_is_read_again(network: GuideNetwork, tmp_path: Path) -> None:
    options, path = GuideOptions(name=str(tmp_path / "x.safetensors")), tmp_path / "x.safetensors"
    save_guide(path, network)
    first = configured_guide(options)
    assert configured_guide(options) is first
    save_guide(path, network, kappa=2 * DEFAULT_KAPPA)
    assert configured_guide(options).fingerprint != first.fingerprint


def test_it_is_a_pure_function(network: GuideNetwork) -> None:
    """Under jit, grad and vmap."""
    guide = Guide(network)
    np.testing.assert_allclose(jax.jit(guide.features)(picture()), guide.features(picture()), atol=1e-6)
    slope = jax.grad(lambda x: jnp.sum(guide.features(x) ** 2))(picture())
    assert slope.shape == picture().shape and float(jnp.abs(slope).max()) > 0
    both = jax.vmap(guide.features)(jnp.stack([picture(), picture() / 2]))
    np.testing.assert_allclose(both[0], guide.features(picture()), atol=1e-5)


def test_the_fingerprint_tells_weights_and_kappa_apart(network: GuideNetwork, tmp_path: Path) -> None:
    def fingerprint(kappa: float, shift: float = 0.0) -> str:
        changed = nnx.clone(network)
        bias = changed.segmentation_head[0].bias
        bias.set_value(bias[...] + shift)
        save_guide(tmp_path / "x.safetensors", changed, kappa=kappa, dtype="float32")
        return load_guide(tmp_path / "x.safetensors").fingerprint

    assert fingerprint(1.0) == fingerprint(1.0)
    assert len({fingerprint(1.0), fingerprint(2.0), fingerprint(1.0, 0.1)}) == 3


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        ({"kappa": "0"}, "its kappa is '0'; it must be a number > 0"),
        ({"kappa": "small"}, "its kappa is 'small'"),
        ({"kappa": "nan"}, "its kappa is 'nan'"),
        ({"norm": "mean_abs"}, "trained for the norm 'mean_abs'"),
    ],
)
def test_files_that_make_no_guide(
    network: GuideNetwork, tmp_path: Path, texts: dict[str, str], message: str
) -> None:
    path = tmp_path / "x.safetensors"
    save_guide(path, network, dtype="float32")
    metadata = {"encoder": "toy", "kappa": "1", "norm": "l2", **texts}
    path.write_bytes(safetensors.numpy.save(safetensors.numpy.load_file(path), metadata=metadata))
    with pytest.raises(InputError, match=message):
        load_guide(path)


@pytest.mark.parametrize("shape", [(8, 8), (8, 8, 4), (0, 8, 3), (1, 8, 8, 3)])
def test_pictures_of_another_shape(network: GuideNetwork, shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match=r"display: .*must be a float array of shape h x w x 3"):
        Guide(network).features(jnp.zeros(shape))


def test_layers_fold_once() -> None:
    layer = ConvNorm(3, 4, names=("conv", "bn"), rngs=nnx.Rngs(0))
    layer.fold()
    kernel = layer.conv.kernel[...]
    layer.fold()
    np.testing.assert_array_equal(layer.conv.kernel[...], kernel)
