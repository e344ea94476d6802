"""Weights of guides in and out of files: torch's, ours, damaged ones and those of other networks."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import safetensors.numpy
from extras import need
from flax import nnx

from experiments import convert_weights
from hyjax.guide import ENCODERS, GuideNetwork, load_network, load_weights, save_guide
from hyjax.guide.layers import ConvNorm
from hyjax.guide.weights import named_variables
from hyjax.util.errors import InputError

FIRST = "encoder.model.conv1.weight"


class Toy(nnx.Module):
    """One strided convolution and a depthwise one."""

    def __init__(self, *, rngs: nnx.Rngs) -> None:
        self.channels = (4,)
        self.first = ConvNorm(3, 4, 3, 2, names=("conv1", "bn1"), rngs=rngs)
        self.second = ConvNorm(4, 4, 5, names=("conv2", "bn2"), depthwise=True, rngs=rngs)

    def __call__(self, image: jax.Array) -> list[jax.Array]:
        return [self.second(self.first(image))]


@pytest.fixture(autouse=True)
def toy_encoder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ENCODERS, "toy", Toy)


def toy(features: int = 5, seed: int = 0) -> GuideNetwork:
    """A network with weights and statistics of its own."""
    network = GuideNetwork("toy", features, rngs=nnx.Rngs(seed))
    rng = np.random.default_rng(seed)
    for variable in named_variables(network).values():
        variable.set_value(jnp.asarray(rng.uniform(0.5, 1.5, variable.shape), jnp.float32))
    return network


def arrays_of(network: GuideNetwork) -> dict[str, np.ndarray]:
    return {name: np.asarray(variable[...]) for name, variable in named_variables(network).items()}


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "toy.safetensors"
    save_guide(path, toy(), kappa=0.5, metadata={"seed": "7", "command": "hyjax train"}, dtype="float32")
    return path


def changed(path: Path, change: Callable[[dict[str, np.ndarray]], None]) -> Path:
    """The file with other tensors, and the same text."""
    with safetensors.safe_open(path, framework="numpy") as opened:
        metadata = opened.metadata()
    tensors = safetensors.numpy.load_file(path)
    change(tensors)
    path.write_bytes(safetensors.numpy.save(tensors, metadata=metadata))
    return path


# ---- round trips ----


def test_round_trip(saved: Path) -> None:
    network, metadata = load_network(saved)
    assert metadata == {
        "encoder": "toy", "features": "5", "kappa": "0.5", "norm": "l2", "seed": "7", "command": "hyjax train",
    }  # fmt: skip
    before, after = arrays_of(toy()), arrays_of(network)
    assert before.keys() == after.keys()
    for name in before:
        np.testing.assert_array_equal(before[name], after[name], err_msg=name)


def test_half_precision_is_half_the_size(tmp_path: Path, saved: Path) -> None:
    half = tmp_path / "half.safetensors"
    save_guide(half, toy())
    for name, array in arrays_of(load_network(half)[0]).items():
        np.testing.assert_allclose(array, arrays_of(toy())[name], rtol=2**-11)
    assert half.stat().st_size < 0.6 * saved.stat().st_size


def test_kernels_lie_as_torchs_do(saved: Path) -> None:
    tensors = safetensors.numpy.load_file(saved)
    assert tensors[FIRST].shape == (4, 3, 3, 3) and tensors["encoder.model.conv2.weight"].shape == (4, 1, 5, 5)
    np.testing.assert_array_equal(tensors[FIRST][1, 2], arrays_of(toy())[FIRST][:, :, 2, 1])


@pytest.mark.slow
def test_torchs_round_trip(tmp_path: Path) -> None:
    """torch → ours → torch, bit for bit; the encoder is recognised by its tensors."""
    from reference import torch_unet as reference

    theirs = reference.torch_unet("mobilenetv4_conv_small", features=8)
    before = {name: tensor.clone() for name, tensor in theirs.state_dict().items()}
    reference.torch.save({"state_dict": theirs.state_dict(), "epoch": 3}, tmp_path / "theirs.pth")
    convert_weights.main(convert_weights.Config(str(tmp_path / "theirs.pth")))
    network, metadata = load_network(tmp_path / "theirs.safetensors")
    assert (network.encoder_name, network.features, metadata) == ("mobilenetv4_conv_small", 8, {})
    save_guide(tmp_path / "ours.safetensors", network, dtype="float32")
    ours = safetensors.numpy.load_file(tmp_path / "ours.safetensors")
    fresh = reference.torch_unet("mobilenetv4_conv_small", features=8, seed=1)
    fresh.load_state_dict({name: reference.torch.tensor(array) for name, array in ours.items()}, strict=True)
    for name, tensor in fresh.state_dict().items():
        if not name.endswith("num_batches_tracked"):
            assert reference.torch.equal(tensor, before[name]), name


@pytest.mark.slow
def test_timms_encoder_alone(tmp_path: Path) -> None:
    """A whole timm model, with its classifier, fills the encoder and leaves the decoder."""
    from reference import torch_unet as reference

    reference.torch_unet("mobilenetv4_conv_small")  # makes timm importable
    need("timm")
    import timm

    model = timm.create_model("mobilenetv4_conv_small")
    path = tmp_path / "timm.safetensors"
    safetensors.numpy.save_file({name: tensor.numpy() for name, tensor in model.state_dict().items()}, path)
    network = GuideNetwork("mobilenetv4_conv_small", rngs=nnx.Rngs(0))
    head = np.asarray(network.segmentation_head[0].kernel[...])
    load_weights(path, network)
    stem = arrays_of(network)["encoder.model.conv_stem.weight"]
    np.testing.assert_array_equal(stem, model.conv_stem.weight.detach().numpy().transpose(2, 3, 1, 0))
    np.testing.assert_array_equal(network.segmentation_head[0].kernel[...], head)


def test_names_of_parallel_training(saved: Path) -> None:
    """torch prefixes every name when several devices train."""

    def prefix(tensors: dict[str, np.ndarray]) -> None:
        for name in list(tensors):
            tensors[f"module.{name}"] = tensors.pop(name)

    np.testing.assert_array_equal(
        arrays_of(load_network(changed(saved, prefix))[0])[FIRST], arrays_of(toy())[FIRST]
    )


# ---- weights that do not fit ----


def without(name: str) -> Callable[[dict[str, np.ndarray]], None]:
    def change(tensors: dict[str, np.ndarray]) -> None:
        del tensors[name]

    return change


def replaced(name: str, array: np.ndarray) -> Callable[[dict[str, np.ndarray]], None]:
    return lambda tensors: tensors.update({name: array.astype(np.float32)})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (without(FIRST), rf"not whole: 1 of 22 tensors of toy are missing, first {FIRST}"),
        (replaced("decoder.blocks.9.x", np.zeros(1)), "no place for 1 tensors, first decoder.blocks.9.x"),
        (
            replaced(FIRST, np.zeros((4, 4, 3, 3))),
            rf"another network: {FIRST} has shape \(4, 4, 3, 3\), where toy with 5 features needs \(4, 3, 3, 3\)",
        ),
        (replaced("encoder.model.bn1.running_var", np.full(4, np.nan)), "bn1.running_var is not finite"),
        (replaced("segmentation_head.0.bias", np.zeros(3)), r"head.0.bias has shape \(3,\), where"),
    ],
)
def test_weights_that_do_not_fit(
    saved: Path, change: Callable[[dict[str, np.ndarray]], None], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        load_network(changed(saved, change))


def test_another_number_of_features(saved: Path) -> None:
    network = toy(features=6)
    before = arrays_of(network)
    with pytest.raises(InputError, match=r"segmentation_head.0.bias has shape \(5,\), .* 6 features needs \(6,\)"):
        load_weights(saved, network)
    for name, array in arrays_of(network).items():
        np.testing.assert_array_equal(array, before[name], err_msg="a network was half filled")


def test_weights_of_another_encoder(saved: Path) -> None:
    with pytest.raises(InputError, match=r"of mobilenetv4_conv_small are missing, first encoder.model.blocks.0.0"):
        load_network(saved, encoder="mobilenetv4_conv_small")
    tensors = safetensors.numpy.load_file(saved)
    saved.write_bytes(safetensors.numpy.save({n: a for n, a in tensors.items() if n != FIRST}))
    with pytest.raises(InputError, match="weights of an unknown network; the encoder is none of mobilenetv4"):
        load_network(saved)


# ---- saving ----


@pytest.mark.parametrize(
    ("value", "dtype", "message"),
    [
        (7e4, "float16", "conv1.weight reaches 7e.04, too large for float16; save it as float32"),
        (np.nan, "float32", "conv1.weight is not finite"),
        (-np.inf, "float16", "conv1.weight is not finite"),
    ],
)
def test_numbers_that_cannot_be_saved(tmp_path: Path, value: float, dtype: Any, message: str) -> None:
    network = toy()
    kernel = named_variables(network)[FIRST]
    kernel.set_value(kernel[...].at[0, 1, 2, 3].set(value))
    with pytest.raises(InputError, match=message):
        save_guide(tmp_path / "x.safetensors", network, dtype=dtype)
    assert not list(tmp_path.iterdir())


def test_large_numbers_are_saved_in_single_precision(tmp_path: Path) -> None:
    network = toy()
    kernel = named_variables(network)[FIRST]
    kernel.set_value(kernel[...].at[0, 1, 2, 3].set(7e4))
    save_guide(tmp_path / "x.safetensors", network, dtype="float32")
    assert arrays_of(load_network(tmp_path / "x.safetensors")[0])[FIRST][0, 1, 2, 3] == np.float32(7e4)


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot write"):
        save_guide(tmp_path / "missing" / "x.safetensors", toy())


# ---- files that are something else ----


@pytest.mark.parametrize("content", [b"", b"\x00" * 100, b"PK\x03\x04 nothing", b"\x80\x02}q\x00."])
def test_other_files(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.safetensors"
    path.write_bytes(content)
    message = "not safetensors, or damaged .*; in a clone, python -m experiments.convert_weights makes"
    with pytest.raises(InputError, match=message) as caught:
        load_network(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kept", [4, 200, -1])
def test_truncated_safetensors(saved: Path, kept: int) -> None:
    saved.write_bytes(saved.read_bytes()[:kept])
    with pytest.raises(InputError, match="damaged"):
        load_network(saved)


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_network(tmp_path / "x.safetensors")
    with pytest.raises(InputError, match="is a folder"):
        load_network(tmp_path)


def test_hub_addresses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(InputError, match="needs the package huggingface_hub"):
        load_network("hf://timm/mobilenetv4/model.safetensors")
