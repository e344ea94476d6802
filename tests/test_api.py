"""The law of the public API, the direction of imports, and what `import hyjax` may load."""

import ast
import inspect
import subprocess
import sys
import types
import typing
from collections.abc import Callable, Iterator
from pathlib import Path

import jax
import numpy as np
import pytest

import hyjax
from hyjax.util.settings import Settings

PACKAGE = Path(hyjax.__file__).parent
PUBLIC = {name: getattr(hyjax, name) for name in hyjax.__all__}
FUNCTIONS = {name: thing for name, thing in PUBLIC.items() if callable(thing) and not isinstance(thing, type)}
CLASSES = {name: thing for name, thing in PUBLIC.items() if isinstance(thing, type)}
METHODS = {
    f"{name}.{attribute}": thing
    for name, cls in CLASSES.items()
    for attribute, thing in inspect.getmembers(cls, callable)
    if not attribute.startswith("_") and cls.__module__ == getattr(inspect.unwrap(thing), "__module__", None)
}
CALLABLES = {**FUNCTIONS, **METHODS}
# The first parameters may be given by place: what is worked on, what guides it, and the numbers of the equation.
MOST_POSITIONAL = 5


def parts(annotation: object) -> Iterator[object]:
    yield annotation
    for argument in typing.get_args(annotation):
        yield from parts(argument)


def test_all_is_sorted_and_complete() -> None:
    assert sorted(hyjax.__all__) == hyjax.__all__
    assert set(hyjax.__all__) <= set(dir(hyjax))
    exec("from hyjax import *", names := {})
    assert set(hyjax.__all__) <= set(names)


@pytest.mark.parametrize("name", [*FUNCTIONS, *CLASSES])
def test_docstrings(name: str) -> None:
    doc = inspect.getdoc(PUBLIC[name])  # indented alike by all versions of Python
    assert doc and not doc.startswith(f"{name}("), "no docstring"
    first = doc.strip().splitlines()[0]
    assert first.endswith(".") and len(first) < 120
    if name in FUNCTIONS:
        parameters = inspect.signature(FUNCTIONS[name]).parameters
        if "Args:" in doc:
            section = doc.split("Args:")[1].split("\n\n")[0]
            told = {
                line.split(":")[0].strip() for line in section.splitlines() if line[4:5].isalpha() and ":" in line
            }
            assert told == set(parameters), "Args and signature differ"
    elif "Attributes:" in doc:
        for field in PUBLIC[name].__dataclass_fields__:
            assert f"    {field}: " in doc, f"attribute {field} is not described"


@pytest.mark.parametrize("name", CALLABLES)
def test_signatures(name: str) -> None:
    """Every parameter and result annotated; arrays with their shape; few by place; options by name only."""
    signature = inspect.signature(CALLABLES[name])
    assert signature.return_annotation is not inspect.Signature.empty, "result is not annotated"
    positional = []
    for parameter in signature.parameters.values():
        if parameter.name in ("self", "cls"):
            continue
        assert parameter.annotation is not inspect.Parameter.empty, f"{parameter.name} is not annotated"
        assert parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD), "no *args or **kwargs"
        if parameter.kind is not parameter.KEYWORD_ONLY:
            positional.append(parameter.name)
            if parameter.name not in ("settings", "configuration"):  # all of whose fields have defaults
                assert parameter.default is parameter.empty, f"{parameter.name} has a default: options come after *"
    assert len(positional) <= MOST_POSITIONAL
    for annotation in [p.annotation for p in signature.parameters.values()] + [signature.return_annotation]:
        for part in parts(annotation):
            assert part not in (jax.Array, np.ndarray), "an array without its shape: use jaxtyping"


@pytest.mark.parametrize(
    "name",
    [
        name
        for name, cls in CLASSES.items()
        if hasattr(cls, "__dataclass_fields__") and not issubclass(cls, Settings)
    ],
)
def test_classes_are_frozen_pytrees(name: str) -> None:
    cls = CLASSES[name]
    assert cls.__dataclass_params__.frozen
    filler = dict.fromkeys(cls.__dataclass_fields__, 1.0)
    if name == "Level":
        filler["factor"] = 2
    if name == "Schedule":
        filler = {"levels": (hyjax.Level(2, np.zeros(1), 1.0),)}
    value = cls(**filler)
    leaves, structure = jax.tree.flatten(value)
    again = jax.tree.unflatten(structure, leaves)
    assert leaves and type(again) is cls and jax.tree.flatten(again) == (leaves, structure)
    for annotation in typing.get_type_hints(cls).values():
        for part in parts(annotation):
            assert part not in (jax.Array, np.ndarray), "an array without its shape: use jaxtyping"


# ---- imports run one way only ----

# Lowest first; folders of one row do not import each other. Files of one folder may, but not in a circle.
LAYERS: list[set[str]] = [
    {"util"},
    {"core"},
    {"light"},
    {"pipeline", "video"},
    {"choices"},
    {"configuration"},
    {""},  # hyjax/__init__.py: the public names
    {"metrics"},
    {"geometry"},
    {"synthetic"},
    {"data"},
    {"photo_light"},
    {"guide"},
    {"scene"},
    {"pairs"},
    {"training"},
    {"device"},
    {"relighting"},
    {"tuning"},
    {"sweep"},
    {"live"},
    {"exploration"},
    {"tour"},
    {"export"},
    {"info"},
    {"cli"},
    {"__main__"},
]
LAYER = {module: level for level, row in enumerate(LAYERS) for module in row}
PURE = {"core", "light", "pipeline", "video"}
JAX_ONLY = {"jax", "jaxtyping", "numpy"}  # and the standard library: what the pure layers may import
SYSTEM = {"os", "pathlib", "pickle", "platform", "shutil", "subprocess", "sys", "tempfile"}
"""Files, processes and the environment, which the pure layers do not know."""
PURE_UTIL = {
    "errors",
    "argument_kinds",
    "arguments",
    "geometry",
    "reading",
    "vectors",
    "tracing",
    "cores",
}  # of util, what the pure layers may import
BESIDES = {
    "core.solver": {"jaxopt"}
}  # its implicit derivatives; when it is asked to solve, as the import stays light


def modules() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def imports(path: Path) -> Iterator[tuple[int, str]]:
    """Line and full name of everything imported, at the top and inside functions; relative ones made absolute."""
    package = ["hyjax", *path.relative_to(PACKAGE).parent.parts]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            start = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*start, *([node.module] if node.module else [])])
            # `from hyjax import cascade` and `from hyjax.scene import mesh` name modules
            yield from ((node.lineno, f"{module}.{alias.name}") for alias in node.names)


def layer_name(module: str) -> str:
    """`hyjax.geometry.camera.Camera` → geometry; `hyjax.Level` → the package itself."""
    name = [*module.split("."), ""][1]
    return name if name in LAYER or (PACKAGE / name).is_dir() or (PACKAGE / f"{name}.py").is_file() else ""


def module_name(path: Path) -> str:
    """`hyjax/core/cascade.py` → core.cascade."""
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix("__init__").removesuffix(".")


def offences(path: Path) -> Iterator[str]:
    module = module_name(path)
    own = module.split(".")[0]
    if own not in LAYER:
        yield f"{path}: module {own!r} has no layer yet; give it one in LAYERS"
        return
    for line, imported in imports(path):
        top = imported.split(".")[0]
        if top != "hyjax":
            deferred = path.read_text(encoding="utf-8").splitlines()[line - 1].startswith(" ")
            besides = BESIDES.get(module, set()) if deferred else set()
            if own in PURE and top not in (JAX_ONLY | sys.stdlib_module_names | besides) - SYSTEM:
                yield f"{path}:{line}: the pure core imports {top}"
            continue
        target = layer_name(imported)
        if own == "" or target not in LAYER:
            continue
        if own in PURE and target == "util" and imported.split(".")[2] not in PURE_UTIL:
            yield f"{path}:{line}: the pure core imports {imported}"
        if target != own and LAYER[target] >= LAYER[own]:
            yield f"{path}:{line}: {own} imports {imported}, which lies above or beside it"


def test_imports_run_downwards() -> None:
    found = [offence for path in modules() for offence in offences(path)]
    assert not found, "\n".join(found)


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Modules that import each other, directly or around a circle."""
    found: list[list[str]] = []
    state: dict[str, int] = {}

    def visit(module: str, trail: list[str]) -> None:
        state[module] = 1
        for other in sorted(graph.get(module, ())):
            if state.get(other) == 1:
                found.append([*trail[trail.index(other) :], other])
            elif other not in state:
                visit(other, [*trail, other])
        state[module] = 2

    for module in sorted(graph):
        if module not in state:
            visit(module, [module])
    return found


def import_graph() -> dict[str, set[str]]:
    """Which file imports which, inside folders too; imports inside functions and for types alone included."""
    names = {module_name(path): path for path in modules()}
    graph: dict[str, set[str]] = {}
    for name, path in names.items():
        if not name:
            continue  # the package itself offers names from everywhere, lazily
        targets = {full.removeprefix("hyjax.") for _, full in imports(path) if full.startswith("hyjax.")}
        graph[name] = {t if t in names else t.rpartition(".")[0] for t in targets} & names.keys() - {name, ""}
    return graph


def test_no_circle_of_imports() -> None:
    assert not (found := circles(import_graph())), "\n".join(" → ".join(circle) for circle in found)


def test_the_circle_test_can_fail() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}}) == [["a", "b", "c", "a"]]
    assert circles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


@pytest.mark.parametrize(
    ("place", "line"),
    [
        ("core/cascade.py", "from hyjax.pipeline import relight"),
        ("core/stencil.py", "    import hyjax.light.kinds"),
        ("geometry/camera.py", "from hyjax.data import capture"),
        ("synthetic/room/path.py", "from ...data.capture import Frame"),
        ("core/diffusion.py", "from hyjax import Level"),
        ("light/shadow_map.py", "import trimesh"),
        ("core/solver.py", "import scipy"),
        ("core/backends.py", "import os"),
        ("core/solver.py", "TOP from jaxopt import linear_solve"),
        ("core/diffusion.py", "from jaxopt import linear_solve"),
        ("core/diffusion.py", "from hyjax.util.files import write_text"),
        ("util/cache.py", "from hyjax.core.schedule import Schedule"),
        ("data/arkit_scenes.py", "from hyjax.scene.surfaces import surface_of"),
    ],
)
def test_the_import_test_can_fail(place: str, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / place
    path.parent.mkdir(parents=True, exist_ok=True)
    for name in LAYER:
        (tmp_path / name).mkdir(exist_ok=True)
    at_top = line.startswith("TOP ")
    path.write_text(f"{line[4:]}\n" if at_top else f"def f():\n    {line.strip()}\n")
    monkeypatch.setattr(sys.modules[__name__], "PACKAGE", tmp_path)
    assert list(offences(path))


def loaded_by(code: str) -> set[str]:
    """Packages that a program has loaded when it ends."""
    program = f"import atexit, sys; atexit.register(lambda: print(*sys.modules, file=sys.stderr)); {code}"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=120)
    return {name.split(".")[0] for name in done.stderr.splitlines()[-1].split()}


@pytest.mark.parametrize(
    "code",
    [
        "import hyjax; hyjax.InputError",
        "import hyjax; hyjax.RelightSettings()",
        *(
            f"sys.argv = {['hyjax', *words]}; import hyjax.cli; hyjax.cli.main()"
            for words in (
                ["--version"],
                ["--help"],
                ["relight", "--help"],
                ["train", "--help"],
                ["tune", "--help"],
                ["sweep", "--help"],
            )
        ),
    ],
)
def test_what_computes_nothing_loads_no_library(code: str) -> None:
    heavy = {"jax", "numpy", "scipy", "msgspec"}
    assert not (found := loaded_by(code) & heavy), f"loads {sorted(found)}"


def test_a_pure_function_loads_jax_alone() -> None:
    loaded = loaded_by("import hyjax; hyjax.relight")
    heavy = {
        "flax",
        "trimesh",
        "embreex",
        "numba",
        "OpenImageIO",
        "skimage",
        "tyro",
        "optax",
        "jaxopt",
        "orbax",
        "grain",
        "PIL",
        "h5py",
        "safetensors",
        "tqdm",
        "yaml",
    }
    assert "jax" in loaded and not loaded & heavy, f"loads {sorted(loaded & heavy)}"


def test_no_postponed_annotations() -> None:
    for path in modules():
        assert "from __future__ import annotations" not in path.read_text(encoding="utf-8"), path


def test_input_error_is_one_line() -> None:
    """Also from within jit, where JAX adds notes of its own: the message itself stays one line."""
    calls: list[Callable[[], object]] = [
        lambda: hyjax.downsample(np.zeros((3, 3, 1)), 0),
        lambda: hyjax.conductance(np.zeros((3, 3)), 1.0),
        lambda: hyjax.Schedule.preset("?"),
        lambda: hyjax.guided_upsample(np.zeros((3, 3, 1)), 2, np.zeros((9, 9, 1)), 1.0),
        lambda: hyjax.step_cycle(0, 1.0),
        lambda: hyjax.step_cycle(3, 100.0),
        lambda: hyjax.diffuse(np.zeros((1, 1, 1)), (np.zeros((0, 1)), np.zeros((1, 0))), [0.1], fidelity=-1.0),
        lambda: hyjax.solve(np.zeros((1, 1, 1)), (np.zeros((0, 1)), np.zeros((1, 0))), 0.0),
    ]
    for call in calls:
        with pytest.raises(hyjax.InputError) as caught:
            call()
        assert isinstance(caught.value, ValueError) and "\n" not in str(caught.value)
    assert isinstance(hyjax, types.ModuleType)


def test_files_and_functions_stay_small() -> None:
    """At most ten files lie flat in the package, twelve parameters in a function, 350 lines in a file."""
    assert len(list(PACKAGE.glob("*.py"))) <= 10
    for path in modules():
        text = path.read_text(encoding="utf-8")
        assert text.count("\n") <= 350, path
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef):
                every = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                assert len([a for a in every if a.arg not in ("self", "cls")]) <= 12, f"{path}: {node.name}"
