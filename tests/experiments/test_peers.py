"""What the speed benchmark compares with computes the same, and its guard guards."""

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from extras import need

from experiments import peers
from experiments.peers_report import COPY, FLOOR, OURS, PLAIN, SMOOTHER, TORCH, blocks, guard
from hyjax import Schedule, cascade, conductance
from hyjax.core.diffusion import _steps
from hyjax.util.errors import InputError

LAM = 0.2


def example(h: int, w: int, c: int) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    return random.random((h, w, c), np.float32), random.random((h, w, 3), np.float32)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("shape", [(7, 9, 1), (40, 33, 3)])
@pytest.mark.parametrize("steps", [1, 4])
def test_the_floor_is_the_same_diffusion(shape: tuple[int, int, int], steps: int) -> None:
    y, guide = example(*shape)
    edges = conductance(jnp.asarray(guide), 0.3)
    expected = _steps(jnp.asarray(y), edges, jnp.full(steps, LAM), None, None)
    host = [np.asarray(edge) for edge in edges]
    found = peers.Floor().diffuse(np.moveaxis(y, -1, 0), host, steps, LAM, threads=2)()
    np.testing.assert_allclose(np.moveaxis(found, 0, -1), expected, atol=2e-6)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_floor_leaves_subnormal_numbers() -> None:
    peers.Floor()
    assert np.array([5e-324])[0] > 0, "loading the floor made this thread take subnormal numbers for zero"


def test_without_a_compiler_one_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "FLAGS", ["--no-such-option"])
    with pytest.raises(InputError, match="needs gcc with OpenMP"):
        peers.Floor()


def test_torchs_cascade_is_ours() -> None:
    need("torch")
    import torch

    y, guide = example(64, 48, 2)
    schedule = dataclasses.replace(Schedule.uniform([(4, 3), (2, 2)], kappa=0.3), pooling="guide")
    inputs = [torch.tensor(np.moveaxis(x, -1, 0)[None].copy()) for x in (y, guide)]
    found = np.moveaxis(peers.torch_cascade(*inputs, schedule)[0].numpy(), 0, -1)
    np.testing.assert_allclose(found, cascade(jnp.asarray(y), jnp.asarray(guide), schedule), atol=2e-6)


def rows(ours: float) -> list[dict[str, Any]]:
    """A finished run in which ours takes `ours` ms and everybody else 1."""
    stamp = {
        "experiment": "bench_peers", "settings": {}, "seed": 0, "commit": "0" * 40, "device": "cpu: cpu",
        "cpu_count": 2, "versions": {"jax": "0.10"},
    }  # fmt: skip
    time = {"first_ms": 2.0, "median_ms": 1.0, "p95_ms": 1.0}
    made: list[dict[str, Any]] = [{"kind": "conditions", "cores": 1, "capture": "room", "meshes": "scan"}]
    made += [
        {"kind": "step", "size": 256, "channels": 3, "who": who, "bytes": 100, "operations": 100} | time
        for who in (OURS, PLAIN, TORCH, FLOOR, COPY)
    ]
    made += [{"kind": "cascade", "schedule": "paper-50", "who": who} | time for who in (OURS, TORCH)]
    made += [
        {"kind": "quality", "who": who, "chosen": [0.1, 3.0], "at_end": True, "psnr": 30.0, "loss": 0.1}
        for who in (OURS, SMOOTHER)
    ]
    made += [{"kind": "quality time", "who": who, "channels": 3} | time for who in (OURS, SMOOTHER)]
    made += [{"kind": "guide", "size": size, "who": who} | time for size in (256, 512) for who in (OURS, TORCH)]
    made += [{"kind": "agreement", "what": "steps", "difference": 1e-6 * ours}]
    for row in made:
        if row.get("who") == OURS and "median_ms" in row:
            row["median_ms"] = ours
    return [row | stamp for row in made]


def test_the_guard_holds_and_breaks() -> None:
    assert all(holds for *_, holds in guard(rows(0.1)))
    broken = [what for what, _, _, holds in guard(rows(10_000.0)) if not holds]
    assert len(broken) == len(guard(rows(1.0)))


@pytest.mark.parametrize("kind", ["step", "cascade", "quality time", "guide", "agreement"])
def test_what_was_not_measured_does_not_hold(kind: str) -> None:
    missing = [row for row in rows(0.1) if row["kind"] != kind]
    assert not all(holds for *_, holds in guard(missing))


def test_a_run_is_told(tmp_path: Path) -> None:
    told = blocks(rows(0.5), tmp_path)
    header, lines = told[0].header, told[0].rows  # type: ignore[union-attr]
    assert header[-1] == "times the C loop"
    assert {line[1]: line[-1] for line in lines}[OURS] == "0.50"
    assert len(told) == 6
