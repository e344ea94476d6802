"""The guide network against timm and segmentation_models_pytorch in torch, on random weights."""

import copy
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from safetensors.numpy import save_file

from hyjax.guide import ENCODERS, GuideNetwork, load_network, register_encoder
from hyjax.guide.convolution import convolve, convolve_depthwise, convolve_upsampled, parity_kernels, upsample
from hyjax.guide.layers import ConvNorm
from hyjax.guide.weights import from_torch_layout, named_variables
from hyjax.util.errors import InputError

SMALL, MEDIUM = "mobilenetv4_conv_small", "mobilenetv4_conv_medium"
TOLERANCE = 1e-4
"""Of the largest value of a stage."""


class Toy(nnx.Module):
    """Two maps, at a half and a quarter of the size."""

    def __init__(self, *, rngs: nnx.Rngs) -> None:
        self.channels = (4, 6)
        self.first = ConvNorm(3, 4, 3, 2, names=("conv1", "bn1"), rngs=rngs)
        self.second = ConvNorm(4, 6, 5, 2, names=("conv2", "bn2"), rngs=rngs)

    def __call__(self, image: jax.Array) -> list[jax.Array]:
        first = self.first(image)
        return [first, self.second(first)]


def distance(ours: jax.Array | np.ndarray, theirs: np.ndarray) -> float:
    """Largest difference, in multiples of the largest value."""
    assert ours.shape == theirs.shape
    return float(np.abs(np.asarray(ours) - theirs).max() / np.abs(theirs).max())


def pictures(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(*shape, 3)).astype(np.float32)


# ---- parity with torch ----


@pytest.fixture(scope="module", params=[SMALL, MEDIUM])
def pair(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[GuideNetwork, Any]:
    """The same network, ours and torch's."""
    from reference import torch_unet as reference

    theirs = reference.torch_unet(request.param)
    path: Path = tmp_path_factory.mktemp("weights") / "unet.safetensors"
    save_file({name: tensor.numpy() for name, tensor in theirs.state_dict().items()}, path)
    return load_network(path)[0], theirs


def our_stages(network: GuideNetwork, images: np.ndarray) -> list[jax.Array]:
    graph, state = nnx.split(network)

    @jax.jit
    def run(state: Any, images: jax.Array) -> list[jax.Array]:
        network = nnx.merge(graph, state)
        maps = network.encoder(images)
        levels = network.decoder.levels(maps, images.shape[1], images.shape[2])
        return [*maps, *levels, network(images)]

    return run(state, jnp.asarray(images))


@pytest.mark.slow
@pytest.mark.parametrize("size", [(64, 96), (99, 135)], ids=str)
def test_every_stage_is_torchs(pair: tuple[GuideNetwork, Any], size: tuple[int, int]) -> None:
    """Also where no side is divisible by 32, nor even."""
    from reference.torch_unet import stages

    ours, theirs = pair
    images = pictures(1, *size)
    distances = [distance(a, b) for a, b in zip(our_stages(ours, images), stages(theirs, images), strict=True)]
    assert max(distances) < TOLERANCE, distances


@pytest.mark.slow
def test_gradients_and_statistics_are_torchs(pair: tuple[GuideNetwork, Any]) -> None:
    """Of every weight, under the statistics of the batch; in float64, as the many norms blow rounding up."""
    from reference.torch_unet import channels_first

    ours, theirs = pair
    if ours.encoder_name != SMALL:
        pytest.skip("the small network has every kind of layer that has a gradient of its own")
    images = pictures(2, 64, 96).astype(np.float64)
    theirs = copy.deepcopy(theirs).double().train()
    loss = (theirs(channels_first(images)) ** 2).mean()
    loss.backward()
    network = nnx.clone(ours)
    network.train()
    with jax.enable_x64(True):
        graph, weights, statistics = nnx.split(network, nnx.Param, ...)
        weights, statistics = (
            jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), nnx.to_pure_dict(part))
            for part in (weights, statistics)
        )

        @jax.jit
        def run(weights: Any) -> tuple[tuple[jax.Array, Any], Any]:
            def loss(weights: Any) -> tuple[jax.Array, Any]:
                network = nnx.merge(graph, weights, statistics)
                value = jnp.mean(network(images) ** 2)
                return value, nnx.to_pure_dict(nnx.state(network, nnx.Not(nnx.Param)))

            return jax.value_and_grad(loss, has_aux=True)(weights)

        (value, moved), gradient = run(weights)
        assert float(value) == pytest.approx(float(loss.detach()), rel=1e-9)
        for name, variable in named_variables(nnx.merge(graph, gradient, moved)).items():
            result = np.asarray(variable[...])
            if name.endswith(("mean", "var")):
                expected = theirs.state_dict()[name].numpy()
                # torch divides the variance that it keeps by n − 1, and the coarsest map has n = 2·2·3.
                tolerance = 1 / 11 if name.endswith("var") else 1e-9
            else:
                expected = from_torch_layout(theirs.get_parameter(name).grad.numpy())
                tolerance = 1e-8
            scale = max(np.abs(expected).max(), 1e-6)
            assert np.abs(result - expected).max() < tolerance * scale, name


@pytest.mark.slow
def test_starts_as_torchs() -> None:
    """Initial weights have the same spread, layer for layer, and the same range where they are uniform."""
    from reference import torch_unet as reference

    theirs = reference.torch_unet(SMALL, initial=True).state_dict()
    ours = named_variables(GuideNetwork(SMALL, rngs=nnx.Rngs(1)))
    assert set(ours) == {name for name in theirs if not name.endswith("num_batches_tracked")}
    for name, variable in ours.items():
        mine, other = np.asarray(variable[...]), theirs[name].numpy()
        if mine.ndim == 1:
            np.testing.assert_array_equal(mine, other, err_msg=name)
            continue
        # Four standard errors of a ratio of deviations.
        assert np.std(mine) / np.std(other) == pytest.approx(1, abs=4 / np.sqrt(mine.size)), name
        if not name.startswith("encoder"):
            assert np.abs(mine).max() <= np.std(other) * np.sqrt(3) * 1.05, name


def test_sizes_are_those_of_the_paper() -> None:
    def count(encoder: str) -> tuple[int, int]:
        network = nnx.eval_shape(lambda: GuideNetwork(encoder, rngs=nnx.Rngs(0)))
        return tuple(  # type: ignore[return-value]
            sum(leaf.size for leaf in jax.tree.leaves(nnx.state(part, nnx.Param)))
            for part in (network, network.encoder)
        )

    assert [round(n / 1e6, 1) for n in count(SMALL)] == [5.0, 1.3]
    assert [round(n / 1e6, 1) for n in count(MEDIUM)] == [11.1, 7.2]


# ---- encoders ----


def test_any_encoder_can_be_registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hyjax.guide.network.ENCODERS", ENCODERS.copy())
    register_encoder("toy", Toy)
    with pytest.raises(InputError, match="'toy' is registered already"):
        register_encoder("toy", Toy)
    network = GuideNetwork("toy", features=5, rngs=nnx.Rngs(0))
    graph, state = nnx.split(network)
    result = jax.eval_shape(lambda state, x: nnx.merge(graph, state)(x), state, pictures(2, 20, 13))
    assert result.shape == (2, 20, 13, 5)
    assert {name.split(".")[0] for name in named_variables(network)} == {"encoder", "decoder", "segmentation_head"}
    assert "encoder.model.conv1.weight" in named_variables(network)


class TooDeep(Toy):
    def __init__(self, *, rngs: nnx.Rngs) -> None:
        super().__init__(rngs=rngs)
        self.channels = (4,) * 6


@pytest.mark.parametrize(
    ("encoder", "features", "message"),
    [
        ("mobilenetv4_conv_smal", 64, r"did you mean 'mobilenetv4_conv_small'\?"),
        ("toy", 0, "features: need at least 1, got 0"),
        ("deep", 64, "deep has 6 maps; the decoder takes 1 to 5"),
    ],
)
def test_networks_that_cannot_be(
    encoder: str, features: int, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(ENCODERS, "toy", Toy)
    monkeypatch.setitem(ENCODERS, "deep", TooDeep)
    with pytest.raises(InputError, match=message):
        GuideNetwork(encoder, features, rngs=nnx.Rngs(0))


def test_pictures_of_another_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ENCODERS, "toy", Toy)
    with pytest.raises(InputError, match=r"need B x H x W x 3 RGB pictures, got shape \(1, 8, 8, 4\)"):
        GuideNetwork("toy", rngs=nnx.Rngs(0))(jnp.zeros((1, 8, 8, 4)))


# ---- convolutions ----


def plain(x: jax.Array, kernel: jax.Array, stride: int, groups: int = 1) -> jax.Array:
    pad = kernel.shape[0] // 2
    return jax.lax.conv_general_dilated(
        x,
        kernel,
        (stride, stride),
        [(pad, pad)] * 2,
        dimension_numbers=("NHWC", "HWIO", "NHWC"),
        feature_group_count=groups,
    )


SHAPES = [(1, 1), (2, 5), (7, 4)]


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("width", [1, 3, 5])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_convolutions_and_their_slopes(shape: tuple[int, int], width: int, stride: int) -> None:
    """Those of depthwise ones are written by hand."""
    key = jax.random.key(0)
    x, kernel, deep = (
        jax.random.normal(key, size) for size in ((2, *shape, 3), (width, width, 3, 4), (width, width, 1, 3))
    )

    @functools.partial(jax.jit, static_argnums=0)
    def with_slopes(convolution: Callable[..., jax.Array], x: jax.Array, kernel: jax.Array) -> list[jax.Array]:
        result, pull_back = jax.vjp(convolution, x, kernel)
        return [result, *pull_back(jnp.sin(result))]

    def check(ours: Callable[..., jax.Array], kernel: jax.Array, groups: int) -> None:
        expected = with_slopes(lambda x, kernel: plain(x, kernel, stride, groups), x, kernel)
        for mine, other in zip(with_slopes(lambda x, k: ours(x, k, stride), x, kernel), expected, strict=True):
            np.testing.assert_allclose(mine, other, atol=1e-4)

    check(convolve, kernel, 1)
    check(convolve, jnp.concatenate([kernel] * 5, -1), 1)  # too many outputs to do two pixels at once
    check(convolve_depthwise, deep, 3)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_parities(shape: tuple[int, int]) -> None:
    """Upsampling and convolving at once is the same as one after the other, and so are its slopes."""
    x, kernel = (jax.random.normal(jax.random.key(0), size) for size in ((2, *shape, 3), (3, 3, 3, 4)))

    @functools.partial(jax.jit, static_argnums=0)
    def with_slopes(convolution: Callable[..., jax.Array]) -> list[jax.Array]:
        result, pull_back = jax.vjp(convolution, x, kernel)
        return [result, *pull_back(jnp.sin(result))]

    expected = with_slopes(lambda x, k: convolve(upsample(x, 2 * x.shape[1], 2 * x.shape[2]), k))
    for mine, other in zip(
        with_slopes(lambda x, k: convolve_upsampled(x, parity_kernels(k))), expected, strict=True
    ):
        np.testing.assert_allclose(mine, other, atol=1e-4)


def test_upsampling_is_cut_to_size() -> None:
    x = jnp.arange(4.0).reshape(1, 2, 2, 1)
    np.testing.assert_array_equal(upsample(x, 3, 4)[0, ..., 0], [[0, 0, 1, 1], [0, 0, 1, 1], [2, 2, 3, 3]])
