"""Training of the network that tells light from paint: a few steps, and weights that can be used."""

from pathlib import Path

import numpy as np
import pytest
from extras import need


@pytest.mark.slow
def test_a_few_steps_write_weights_that_the_default_takes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need("experiments")
    from experiments import light_edges
    from hyjax.guide.edge_weights import edge_weights
    from hyjax.util.tensors import read_tensors

    for name, value in {"SIZE": 72, "CROP": 64, "VIEWS": 2, "WARM_UP": 1}.items():
        monkeypatch.setattr(light_edges, name, value)
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path / "cache"))
    rows = light_edges.main(light_edges.Config(rooms=1, steps=20, out=tmp_path / "out"))
    held = [row for row in rows if row["kind"] == "held out"]
    assert len(held) == 1 and all(np.isfinite(held[0][key]) for key in ("log_light", "difference_before"))
    written, _ = read_tensors(tmp_path / "out" / "light_edges.safetensors")
    assert {name: array.shape for name, array in written.items()} == {
        name: array.shape for name, array in edge_weights().items()
    }
    assert (tmp_path / "out" / "held_out.png").is_file() and (tmp_path / "out" / "training.png").is_file()
