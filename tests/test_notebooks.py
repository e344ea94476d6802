"""The notebooks run from top to bottom, hold no logic of their own, and are kept with small outputs.

    HYJAX_WRITE_NOTEBOOKS=1 pytest -m "" tests/test_notebooks.py

writes what it executed back to `notebooks/`.
"""

import ast
import itertools
import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from common import UNOPTIMISED
from extras import need

FOLDER = Path(__file__).parents[1] / "notebooks"
NOTEBOOKS = sorted(path.name for path in FOLDER.glob("*.ipynb"))
MOST_BYTES = 1_000_000
LIBRARIES = {"dataclasses", "hyjax", "jax", "matplotlib", "numpy", "optax", "pathlib", "tempfile"}
LOGIC = ast.AsyncFunctionDef | ast.ClassDef
MOST_STATEMENTS = 3
"""Most statements of a function: one that is to be changed, such as a loss."""
HOMES = ("/home/", "/root/", "/Users/", "\\Users\\", "/tmp/", str(Path.home()))
METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}
WIDGET = "application/vnd.jupyter.widget-view+json"
"""Output of a widget, which needs a kernel: beside it stands a picture, which alone is kept."""
SECONDS_A_CELL = 600
SMALL_ROOM = "160x120"  # everywhere the same, as in the examples: the photo's light is estimated once
LIGHT_KEPT = 'hyjax.Configuration().with_choices({"photo_light": "kept"})'
EVERY_PIXEL = 'hyjax.Configuration().with_choices({"sampling": 1})'
SMALL_WIDGET = {
    "SceneSettings()": f'SceneSettings(size="{SMALL_ROOM}")',
    'explore(lights="evening-lamps")': f"explore(configuration={EVERY_PIXEL})",  # programs of notebook 02's cells
}
ONE_OF_THE_FRONT = """from hyjax.tuning import proof
proof.ROUNDS = 3
replay.__globals__["POINT_COUNT"] = 1"""
SMALLER = {
    "01_equations.ipynb": {"(512, 512": "(128, 128", "(10, 100, 1000)": "(10, 30, 100)", "1.0, 25)": "1.0, 5)"}
    | SMALL_WIDGET,
    "02_relight_a_room.ipynb": {
        '"noon-window", "evening-lamps", "night-moon"': '"evening-lamps",',  # each compiles programs
    }
    | SMALL_WIDGET,
    "03_tune_a_frame_rate.ipynb": {
        "SceneSettings()": f'SceneSettings(size="{SMALL_ROOM}")',
        "journal =": f"{ONE_OF_THE_FRONT}\njournal =",
        'size="192"': f'size="{SMALL_ROOM}"',
        'frames="0,12", holdout="19,22"': 'frames="0", holdout="19"',
    },
    "04_ablations.ipynb": {
        "import TuneSettings": "import TuneScene, TuneSettings",
        "range(0, 24, 3)": "range(3)",
        "count=16": "count=6",
        "TuneSettings(quiet": f'TuneSettings(TuneScene(size="{SMALL_ROOM}"), quiet',
        "TuneSettings(lights": f'TuneSettings(TuneScene(size="{SMALL_ROOM}"), lights',
        "picture[288:]": "picture[72:]",
        "repeats=20": "repeats=2",
    },
    "05_design_light_by_gradients.ipynb": {"256x192": SMALL_ROOM, "150": "5"},
    "06_the_learned_guide.ipynb": {"320x240": SMALL_ROOM},
    "07_your_own_capture.ipynb": {
        'size="320x240"': f'size="{SMALL_ROOM}", frames="0:24:3"',
        "(0, 8, 16)": "(0, 2, 5)",
        '"noon-window", [lamp]': '"evening-lamps", [lamp]',
        "scene.relit(0, lights)": f"scene.relit(0, lights, {LIGHT_KEPT})",  # its estimate is in other notebooks
    },
    "08_against_the_truth.ipynb": {
        '"builtin-3", 8, 192, 144': '"builtin-0", 6, 96, 72'
    },  # lit for the experiments, too
}
"""Settings that stand in a notebook and those that are executed for them, where its outputs are not kept."""
WRITE = bool(os.environ.get("HYJAX_WRITE_NOTEBOOKS"))

each_notebook = pytest.mark.parametrize("name", NOTEBOOKS)


def read(name: str) -> Any:
    return json.loads((FOLDER / name).read_text(encoding="utf-8"))


def code_cells(notebook: Any) -> list[Any]:
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def program(notebook: Any) -> ast.Module:
    """All code cells, without IPython's magic lines."""
    lines = itertools.chain.from_iterable("".join(cell["source"]).splitlines() for cell in code_cells(notebook))
    return ast.parse("\n".join(line for line in lines if not line.startswith("%")))


def kinds(notebook: Any) -> list[list[Any]]:
    """What each code cell puts out, its content aside."""
    return [
        [
            (out["output_type"], out.get("name"), sorted({*out.get("data", ())} - {WIDGET}))
            for out in cell["outputs"]
        ]
        for cell in code_cells(notebook)
    ]


def complaints(notebook: Any) -> list[str]:
    """Errors, and whatever was written to stderr (a warning is)."""
    outputs = itertools.chain.from_iterable(cell["outputs"] for cell in code_cells(notebook))
    return [str(out) for out in outputs if out["output_type"] == "error" or out.get("name") == "stderr"]


def make_smaller(notebook: Any, replaced: dict[str, str]) -> None:
    """Put smaller settings into the code; each must be there."""
    for old, new in replaced.items():
        cells = [cell for cell in code_cells(notebook) if old in cell["source"]]
        assert cells, f"{old} is no longer in it"
        for cell in cells:
            cell["source"] = cell["source"].replace(old, new)


def test_they_are_numbered() -> None:
    """Else the tests below could not fail."""
    assert [name[:2] for name in NOTEBOOKS] == [f"{n:02d}" for n in range(1, 9)]


@each_notebook
def test_no_logic_of_its_own(name: str) -> None:
    tree = program(read(name))
    nodes = list(ast.walk(tree))
    assert not [ast.unparse(node) for node in nodes if isinstance(node, LOGIC)]
    functions = [node for node in nodes if isinstance(node, ast.FunctionDef)]
    assert not [ast.unparse(function) for function in functions if len(function.body) > MOST_STATEMENTS]
    loop = ast.For | ast.While
    loops = [node for node in nodes if isinstance(node, loop)]
    assert not [ast.unparse(own) for own in loops if any(isinstance(x, loop) for x in ast.walk(own) if x != own)]
    imported = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    imported |= {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)}
    assert "hyjax" in {module.split(".")[0] for module in imported} <= LIBRARIES


@each_notebook
def test_it_ends_with_two_exercises(name: str) -> None:
    last = read(name)["cells"][-1]
    heading, *lines = "".join(last["source"]).strip().splitlines()
    numbers = [line[:3] for line in lines if line[:1].isdigit()]
    assert (last["cell_type"], heading, numbers) == ("markdown", "## Exercises", ["1. ", "2. "])


@each_notebook
def test_kept_outputs(name: str) -> None:
    assert (FOLDER / name).stat().st_size < MOST_BYTES
    notebook = read(name)
    cells = code_cells(notebook)
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    assert any("image/jpeg" in data for cell in kinds(notebook) for _, _, data in cell)
    assert not complaints(notebook)


@each_notebook
def test_nothing_of_the_machine_is_kept(name: str) -> None:
    notebook = read(name)
    assert notebook["metadata"] == METADATA
    assert not any(cell["metadata"] for cell in notebook["cells"])
    text = json.dumps([cell["outputs"] for cell in code_cells(notebook)], ensure_ascii=False)
    assert not [home for home in HOMES if home in text.replace("\\\\", "\\")]


@pytest.fixture(scope="module")
def executed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The notebooks that are asked for, executed each in a folder of its own, without anybody's Jupyter settings.

    What is kept is executed in a kernel for each; else they share one, which is emptied between them.
    """
    need("notebooks")
    import nbclient
    import nbformat

    folder, notebooks = tmp_path_factory.mktemp("notebooks"), {}
    for name in sorted({item.callspec.params["name"] for item in request.session.items if is_run(item)}):
        notebooks[name] = nbformat.read(FOLDER / name, as_version=4)
        shutil.copytree(FOLDER / "tuned", folder / name / "tuned")
        if not WRITE:
            make_smaller(notebooks[name], SMALLER.get(name, {}))
            for cell in notebooks[name].cells:
                cell.id = f"{name[:2]}-{cell.id}"  # unique in all
        notebooks[name].cells.insert(0, nbformat.v4.new_code_cell(f"%reset -f\n%cd -q {folder / name}"))
    with pytest.MonkeyPatch.context() as patch:
        for key in ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR"):
            patch.setenv(key, str(folder / key))
        if WRITE:  # what is kept shows the times of compiled programs as users have them
            patch.delenv("XLA_FLAGS")
        else:  # the tests' own, whose programs are there
            patch.setenv("XLA_FLAGS", UNOPTIMISED)
            patch.setenv("JAX_COMPILATION_CACHE_DIR", os.environ["HYJAX_TESTS_COMPILED"])
            patch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
        for names in [[name] for name in notebooks] if WRITE else [list(notebooks)]:
            together = nbformat.v4.new_notebook(cells=[cell for name in names for cell in notebooks[name].cells])
            options = {"timeout": SECONDS_A_CELL, "record_timing": False, "coalesce_streams": True}
            nbclient.NotebookClient(together, **options, allow_errors=True).execute()
    for name, notebook in notebooks.items():
        del notebook.cells[0]
        for number, cell in enumerate(code_cells(notebook), start=1):
            cell.execution_count = number
        assert [path.name for path in (folder / name).iterdir()] == ["tuned"], f"{name} left files behind"
    return notebooks


def is_run(item: pytest.Item) -> bool:
    return isinstance(item, pytest.Function) and item.function is test_runs


@pytest.mark.slow
@each_notebook
def test_runs(name: str, executed: dict[str, Any]) -> None:
    """Quietly, and with the outputs that are kept."""
    notebook = executed[name]
    assert not complaints(notebook)
    if WRITE:
        need("notebooks")
        import nbformat

        notebook.metadata = METADATA
        for out in itertools.chain.from_iterable(cell["outputs"] for cell in code_cells(notebook)):
            out.get("data", {}).pop(WIDGET, None)
        nbformat.write(notebook, FOLDER / name)
    assert kinds(notebook) == kinds(read(name)), "the kept outputs are of other code: write them anew"
