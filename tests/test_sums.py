"""XLA's sums, which are wrong in some releases of jaxlib unless XLA makes them by its own code."""

import os
import subprocess
import sys

import pytest

import hyjax

OPTION = "--xla_cpu_experimental_ynn_fusion_type"
MASKED_MEANS = """
mean = jax.jit(lambda x, mask: jnp.mean(x, where=mask))
x, mask = jnp.ones((3, 18243)), (jnp.arange(18243) % 3 > 0)[None]
found = {float(mean(x, mask)) for _ in range(500)}
"""
"""Means that are wrong at times on several cores; 1.0 is right (tensorflow/tensorflow#126812)."""
ROW_SUMS = """
x = jnp.arange(32769.0)[:, None] * jnp.eye(3)[0]
rows = jax.jit(jax.vmap(lambda row: jnp.sum((jnp.eye(3) @ row) ** 2)))(x)
found = {float(rows[-1] / 32768.0**2)}
"""
"""Sum that is wrong each time; 1.0 is right (jax-ml/jax#39103)."""


@pytest.mark.parametrize("program", [MASKED_MEANS, ROW_SUMS])
def test_sums_are_right(program: str) -> None:
    environment = {name: value for name, value in os.environ.items() if name not in ("XLA_FLAGS", "NPROC")}
    command = [sys.executable, "-c", f"import hyjax, jax, jax.numpy as jnp\n{program}\nprint(found)"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120, env=environment)
    assert done.stdout == "{1.0}\n"


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("", f"{OPTION}=-reduce"),
        (" --xla_a=1 ", f"--xla_a=1 {OPTION}=-reduce"),
        (f"{OPTION}=dot", f"{OPTION}=dot"),
    ],
)
def test_other_options_of_xla_stay(before: str, after: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jax._src.xla_bridge._backends", {})
    monkeypatch.setenv("XLA_FLAGS", before)
    hyjax._avoid_wrong_sums()
    assert os.environ["XLA_FLAGS"] == after


def test_where_sums_may_be_wrong_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XLA_FLAGS", "")
    with pytest.warns(UserWarning, match="import hyjax first"):  # JAX runs here
        hyjax._avoid_wrong_sums()
    monkeypatch.setattr("jax._src.xla_bridge._backends", {})
    monkeypatch.setenv("XLA_FLAGS", "/etc/flags.txt")
    with pytest.warns(UserWarning, match=r"add it to /etc/flags\.txt"):
        hyjax._avoid_wrong_sums()
    assert os.environ["XLA_FLAGS"] == "/etc/flags.txt"
