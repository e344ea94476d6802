"""The function to export, its unrolled form, settings and files."""

from pathlib import Path

import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hyjax.cli import main
from hyjax.core.schedule import Schedule
from hyjax.export import run as export_run
from hyjax.export import to_stablehlo
from hyjax.export.graph import build_graph, cascade_graph, check_parity, measure_parity
from hyjax.export.run import export_file
from hyjax.export.settings import ExportSettings, Target
from hyjax.export.targets import TARGETS, open_target
from hyjax.export.unroll import unrolled
from hyjax.guide.choose import RGB
from hyjax.scene.settings import SceneSettings
from hyjax.util.errors import InputError
from hyjax.util.extras import optional_module

SMALL = SceneSettings(size="64x48")


def test_a_target_is_a_word_and_a_file() -> None:
    assert {"web", "bench", *TARGETS} == set(Target.__args__)
    for name in TARGETS:
        module = open_target(name)
        assert callable(module.convert) and module.PACKAGES


def test_unrolled_has_neither_loops_nor_calls() -> None:
    graph = cascade_graph(Schedule.preset("hyjax"), RGB, (48, 64), channels=2)
    flat = jax.make_jaxpr(graph.flat)(*graph.specs)
    names = {equation.primitive.name for equation in flat.eqns}
    assert not names & {"scan", "while", "cond", "jit", "pjit", "custom_jvp_call", "dynamic_update_slice"}
    assert all(out.aval.size for equation in flat.eqns for out in equation.outvars)


@hypothesis.settings(max_examples=3)
@hypothesis.given(height=st.integers(8, 40), width=st.integers(8, 40), pooling=st.sampled_from(["edges", "guide"]))
def test_unrolled_computes_the_same(height: int, width: int, pooling: str) -> None:
    schedule = Schedule.uniform([(16, 2), (8, 0), (3 - 1, 1)], pooling=pooling, fidelity=0.1)  # type: ignore[arg-type]
    graph = cascade_graph(schedule, RGB, (height, width), channels=1)
    inputs = [jnp.asarray(graph.examples[port.name]) for port in graph.inputs]
    np.testing.assert_allclose(jax.jit(graph.flat)(*inputs), graph.reference(), atol=1e-5)


def test_unrolled_reversed_scan() -> None:
    def sums(x: jax.Array) -> jax.Array:
        return jax.lax.scan(lambda total, row: (total + row, total), jnp.zeros(2), x, reverse=True)[1]

    x = jnp.arange(6.0).reshape(3, 2)
    np.testing.assert_array_equal(unrolled(sums)(x), sums(x))


def test_holes_are_in_the_example() -> None:
    graph = cascade_graph(Schedule.preset("hyjax"), RGB, (48, 64))
    assert [port.name for port in graph.inputs] == ["filter", "confidence", "guide"]
    assert {0.0, 0.5, 1.0} == set(np.unique(graph.examples["confidence"]).tolist())
    plain = cascade_graph(Schedule.preset("paper-50"), RGB, (48, 64), known=False)
    assert [port.name for port in plain.inputs] == ["filter", "guide"]


def test_a_result_that_differs_is_refused() -> None:
    graph = cascade_graph(Schedule.preset("hyjax"), RGB, (16, 24))
    reference = graph.reference()
    spread = reference.max() - reference.min()
    assert measure_parity(graph, lambda _: reference + 1e-3 * spread) == pytest.approx(1e-3, rel=0.01)
    with pytest.raises(InputError, match=r"differs from JAX by 0\.001 of the value range, more than 0\.0001"):
        check_parity(graph, lambda _: reference + 1e-3 * spread, "onnx")
    with pytest.raises(InputError, match="differs from JAX by inf"):
        check_parity(graph, lambda _: reference * np.nan, "onnx")
    with pytest.raises(InputError, match="gives"):
        check_parity(graph, lambda _: reference[1:], "onnx")


def test_nothing_is_written_of_what_differs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(export_run, "check_parity", lambda *_: check_parity(_[0], lambda x: x["filter"] + 1, "x"))
    with pytest.raises(InputError, match="nothing was written"):
        export_file(ExportSettings(to="stablehlo", scene=SMALL, out=tmp_path / "out", quiet=True))
    assert not (tmp_path / "out").exists()
    (tmp_path / "out").write_text("")
    with pytest.raises(InputError, match="is a file"):
        export_file(ExportSettings(to="stablehlo", scene=SMALL, out=tmp_path / "out", quiet=True))


def test_a_file_of_stablehlo(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = export_file(ExportSettings(to="stablehlo", scene=SMALL, channels=2, out=tmp_path))
    assert {path.name for path in folder.iterdir()} == {"cascade.jaxexport", "cascade.mlirbc", "README.md"}
    text = (folder / "README.md").read_text()
    assert "48 × 64 × 2" in text and "| input | `confidence` |" in text and "- jax " in text
    assert all(line.startswith("export: ") for line in capsys.readouterr().err.splitlines())


@pytest.mark.slow
@hypothesis.settings(max_examples=3)
@hypothesis.given(height=st.integers(8, 33), width=st.integers(8, 33))
def test_stablehlo_of_any_size(height: int, width: int) -> None:
    graph = cascade_graph(Schedule.preset("hyjax"), RGB, (height, width), channels=1)
    run = to_stablehlo.convert(graph).run
    assert run is not None and measure_parity(graph, run) < 1e-5


@pytest.mark.parametrize(
    ("options", "hint"),
    [
        ({"channels": 0}, "channels: a filter has 1 to 64, got 0"),
        ({"schedule": "hyjx"}, "did you mean 'hyjax'"),
        ({"what": "guide"}, "give --guide small"),
        ({"what": "guide", "guide": "small", "scene": SceneSettings(size="16")}, "size: a network needs"),
        ({"triple": "x"}, "triple: goes with --to iree"),
        ({"kappa": -1.0}, "kappa"),
        ({"kappa": 1.0, "schedule": "mine.json"}, "kappa: mine.json brings its own"),
        ({"scene": SceneSettings(size="7")}, "size: '7'"),
        ({"guide": "smal"}, "did you mean 'small'"),
    ],
)
def test_bad_settings(options: dict[str, object], hint: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^[^\n]*$") as caught:
        export_file(ExportSettings(to="stablehlo", out=tmp_path, quiet=True, **options))  # type: ignore[arg-type]
    assert hint in str(caught.value) and not list(tmp_path.iterdir())


def test_a_target_that_is_unknown() -> None:
    with pytest.raises(InputError, match="did you mean 'onnx'"):
        ExportSettings(to="onx")  # type: ignore[arg-type]


def test_a_missing_package_is_named() -> None:
    with pytest.raises(InputError) as caught:
        optional_module("no_such_package.inner", "export-onnx", "export")
    expected = "export: needs the package no_such_package; install it with: pip install '.[export-onnx]'"
    assert str(caught.value) == expected


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("hyjax.cli._keep_for_later", lambda: None)
    monkeypatch.setattr("hyjax.cli.defer_interrupts", lambda: None)
    command = ["hyjax", "export", "--to", "stablehlo", "--size", "24x16", "--quiet", "--out", str(tmp_path)]
    monkeypatch.setattr("sys.argv", command)
    main()
    assert capsys.readouterr().out == f"Look at {tmp_path / 'cascade-stablehlo' / 'README.md'}\n"
    monkeypatch.setattr("sys.argv", [*command, "--channels", "99"])
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 2 and capsys.readouterr().err.startswith("hyjax: channels: ")


@pytest.mark.slow
def test_the_network_by_stablehlo() -> None:
    settings = ExportSettings(to="stablehlo", what="guide", guide="small", scene=SMALL)
    graph = build_graph(settings)
    run = to_stablehlo.convert(graph).run
    assert run is not None and measure_parity(graph, run) < 1e-5 and graph.output.shape[:2] == (48, 64)
