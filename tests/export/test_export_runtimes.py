"""Parity of the targets whose packages are optional, and the examples of their READMEs."""

import re
import subprocess
import sys
from pathlib import Path

import hypothesis
import hypothesis.strategies as st
import pytest
from extras import need

from hyjax.core.schedule import Schedule
from hyjax.export.graph import build_graph, cascade_graph, measure_parity
from hyjax.export.run import export_file
from hyjax.export.settings import ExportSettings
from hyjax.export.targets import open_target
from hyjax.guide.choose import RGB
from hyjax.scene.settings import SceneSettings
from hyjax.util.errors import InputError

# Their own code warns: of Python's protocols, of versions of other packages.
pytestmark = pytest.mark.filterwarnings("default")

SCHEDULES = {
    "edges, bilinear": Schedule.uniform([(8, 3), (4, 2), (2, 2)]),
    "mixed, a level without steps": Schedule.uniform(
        [(6, 3), (2, 0), (1, 2)], upsampling="guide", norm="mean_abs", fidelity=0.2
    ),
    "one row of cells": Schedule.uniform([(63, 2), (3, 3)], pooling="guide"),
}


def need_runtime(target: str) -> None:
    if target != "stablehlo":
        need(f"export-{target}")


def tiny(target: str, out: Path) -> ExportSettings:
    """A few steps on a few pixels."""
    scene = SceneSettings(size="24x16")
    return ExportSettings(to=target, scene=scene, schedule="shadow", out=out, quiet=True)  # type: ignore[arg-type]


@pytest.mark.parametrize("target", ["onnx", "litert", pytest.param("iree", marks=pytest.mark.slow)])
def test_parity_of_the_default(target: str) -> None:
    """Guide, guide, fidelity; a graph of confidence has all that one without it has."""
    check_parity(target, Schedule.preset("hyjax"), known=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCHEDULES)
@pytest.mark.parametrize("target", ["onnx", "litert", "iree"])
def test_parity_of_cascades(target: str, name: str) -> None:
    for known in (False, True) if target != "iree" else (False,):  # IREE takes seconds for each
        check_parity(target, SCHEDULES[name], known=known)


def check_parity(target: str, schedule: Schedule, *, known: bool) -> None:
    need_runtime(target)
    graph = cascade_graph(schedule, RGB, (45, 61), channels=2, known=known)
    assert measure_parity(graph, open_target(target).convert(graph).run) < 1e-5


@pytest.mark.slow
@hypothesis.settings(max_examples=4)
@hypothesis.given(height=st.integers(8, 33), width=st.integers(8, 33))
def test_onnx_of_any_size(height: int, width: int) -> None:
    need("export-onnx")
    for name in ("hyjax", "paper-50"):
        graph = cascade_graph(Schedule.preset(name), RGB, (height, width), channels=1)
        assert measure_parity(graph, open_target("onnx").convert(graph).run) < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("target", ["onnx", "litert"])
def test_parity_of_the_network(target: str) -> None:
    need_runtime(target)
    scene = SceneSettings(size="101x96")
    graph = build_graph(ExportSettings(to=target, what="guide", guide="small", scene=scene))  # type: ignore[arg-type]
    assert measure_parity(graph, open_target(target).convert(graph).run) < 1e-4


@pytest.mark.parametrize("target", ["stablehlo", "onnx", "litert"])
def test_the_readme_s_python_runs(target: str, tmp_path: Path) -> None:
    need_runtime(target)
    folder = export_file(tiny(target, tmp_path))
    (code,) = re.findall(r"```python\n(.*?)```", (folder / "README.md").read_text(), re.DOTALL)
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "(16, 24, 3)\n"


@pytest.mark.parametrize("target", ["onnx", "iree"])
def test_examples_that_nobody_compiles_say_so(target: str, tmp_path: Path) -> None:
    need_runtime(target)
    text = (export_file(tiny(target, tmp_path)) / "README.md").read_text()
    examples = re.findall(r"## .*\n\n(.*neither compile nor run it\.)?\n*```(\w+)\n", text)
    assert examples and all(bool(note) == (language != "python") for note, language in examples)


def test_iree_names_its_function(tmp_path: Path) -> None:
    """In the C example, by the full name that is in the module, and with the inputs' shapes."""
    need("export-iree")
    from iree import runtime

    folder = export_file(tiny("iree", tmp_path))
    text = (folder / "README.md").read_text()
    assert "push_zeros(session, &call, 16, 24, 3);  // filter" in text
    config = runtime.Config("local-task")
    module = runtime.VmModule.copy_buffer(config.vm_instance, (folder / "cascade.vmfb").read_bytes())
    (name,) = re.findall(r'iree_make_cstring_view\("(\S+\.\S+)"\)', text)
    assert name in {f"{module.name}.{function}" for function in module.function_names}


def test_iree_of_a_machine_that_is_none() -> None:
    need("export-iree")
    graph = cascade_graph(Schedule.preset("shadow"), RGB, (16, 16))
    with pytest.raises(InputError, match=r"^export: IREE cannot compile cascade .*$"):
        open_target("iree").convert(graph, "no-such-machine")


@pytest.mark.slow
def test_core_ml_is_converted_and_not_checked(tmp_path: Path) -> None:
    need("export-coreml")
    settings = tiny("coreml", tmp_path)
    folder = export_file(settings)
    assert {path.name for path in folder.iterdir()} == {"cascade.mlpackage", "README.md"}
    assert (folder / "cascade.mlpackage" / "Manifest.json").is_file()
    assert "Not checked here" in (folder / "README.md").read_text()
    export_file(settings)  # over the earlier one
