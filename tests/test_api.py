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

PACKAGE = Path(hyjax.__file__).parent
PUBLIC = {name: getattr(hyjax, name) for name in hyjax.__all__}
FUNCTIONS = {name: thing for name, thing in PUBLIC.items() if callable(thing) and not isinstance(thing, type)}
FUNCTIONS.pop("Light", None)  # a union of types, which is callable in some Python versions
CLASSES = {name: thing for name, thing in PUBLIC.items() if isinstance(thing, type)}
METHODS = {
    f"{name}.{attribute}": thing
    for name, cls in CLASSES.items()
    for attribute, thing in inspect.getmembers(cls, callable)
    if not attribute.startswith("_") and cls.__module__ == getattr(inspect.unwrap(thing), "__module__", None)
}
CALLABLES = {**FUNCTIONS, **METHODS}
LAZY = {"tune"}  # loaded when it is first asked for
# The first parameters may be given by place: what is worked on, what guides it, and the numbers of the equation.
MOST_POSITIONAL = 5


def parts(annotation: object) -> Iterator[object]:
    yield annotation
    for argument in typing.get_args(annotation):
        yield from parts(argument)


def test_all_is_sorted_and_complete() -> None:
    assert sorted(hyjax.__all__) == hyjax.__all__
    imported = {
        alias.asname or alias.name
        for node in ast.parse((PACKAGE / "__init__.py").read_text()).body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert imported | LAZY == set(hyjax.__all__)


@pytest.mark.parametrize("name", [*FUNCTIONS, *CLASSES])
def test_docstrings(name: str) -> None:
    doc = PUBLIC[name].__doc__
    assert doc and not doc.startswith(f"{name}("), "no docstring"
    first = doc.strip().splitlines()[0]
    assert first.endswith(".") and len(first) < 120
    if name in FUNCTIONS:
        parameters = inspect.signature(FUNCTIONS[name]).parameters
        if "Args:" in doc:
            section = doc.split("Args:")[1].split("\n\n")[0]
            told = {
                line.split(":")[0].strip() for line in section.splitlines() if line[8:9].isalpha() and ":" in line
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
            assert parameter.default is parameter.empty, f"{parameter.name} has a default: options come after *"
    assert len(positional) <= MOST_POSITIONAL
    for annotation in [p.annotation for p in signature.parameters.values()] + [signature.return_annotation]:
        for part in parts(annotation):
            assert part not in (jax.Array, np.ndarray), "an array without its shape: use jaxtyping"


@pytest.mark.parametrize("name", [name for name, cls in CLASSES.items() if hasattr(cls, "__dataclass_fields__")])
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

# Lowest first; modules of one row may import each other unless they stand alone.
LAYERS: list[set[str]] = [
    {"errors", "values", "vectors", "cache", "files", "environment", "interrupts", "recent", "overlap"},
    {"stencil", "cycles"},
    {"inplace", "tiles"},
    {"forms"},
    {"pyramid", "diffusion"},
    {"schedule", "upsampling", "solver"},
    {"cascade"},
    {"lights", "gbuffer"},
    {"shading", "shadow", "compositing", "color"},
    {"refine", "superresolution"},
    {"pipeline", "video"},
    {""},  # hyjax/__init__.py: the public names
    {"losses", "metrics"},
    {"images"},
    {"scene"},
    {"data"},
    {"guide"},
    {"contact_sheet"},
    {"training"},
    {"tuning"},
    {"relighting", "tour"},
    {"cli", "__main__"},
]
LAYER = {module: level for level, row in enumerate(LAYERS) for module in row}
ALONE = {"cache", "errors", "values", "vectors"}  # import nothing of hyjax's
JAX_ONLY = {"jax", "jaxtyping", "numpy"}  # and the standard library: what `pipeline` and below may import
BESIDES = {"solver": {"jaxopt"}}  # its implicit derivatives; when it is asked to solve, as the import stays light


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
    """`hyjax.scene.camera.Camera` → scene; `hyjax.Level` → the package itself."""
    name = [*module.split("."), ""][1]
    return name if name in LAYER or (PACKAGE / name).is_dir() or (PACKAGE / f"{name}.py").is_file() else ""


def offences(path: Path) -> Iterator[str]:
    own = layer_name(
        ".".join(["hyjax", *path.relative_to(PACKAGE).with_suffix("").parts]).removesuffix(".__init__")
    )
    if own not in LAYER:
        yield f"{path}: module {own!r} has no layer yet; give it one in LAYERS"
        return
    for line, module in imports(path):
        top = module.split(".")[0]
        if top != "hyjax":
            allowed = JAX_ONLY | sys.stdlib_module_names | BESIDES.get(own, set())
            if LAYER[own] <= LAYER["pipeline"] and own != "cache" and top not in allowed:
                yield f"{path}:{line}: the pure core imports {top}"
            continue
        target = layer_name(module)
        if target == own and path.parent != PACKAGE:
            continue  # within scene/, data/, …
        if own == "" or target not in LAYER:
            continue
        if own in ALONE or LAYER[target] > LAYER[own] or target == own:
            yield f"{path}:{line}: {own} imports {module}, which lies above or beside it"


def test_imports_run_downwards() -> None:
    found = [offence for path in modules() for offence in offences(path)]
    assert not found, "\n".join(found)


def test_the_package_itself_imports_the_core_alone() -> None:
    for line, module in imports(PACKAGE / "__init__.py"):
        if module.split(".")[0] == "hyjax":
            assert LAYER[layer_name(module)] <= LAYER["pipeline"], f"__init__.py:{line}: {module}"


@pytest.mark.parametrize(
    ("place", "line"),
    [
        ("cascade.py", "from hyjax.pipeline import relight"),
        ("stencil.py", "    import hyjax.diffusion"),
        ("scene/camera.py", "from hyjax.data import capture"),
        ("scene/room/path.py", "from ...data.capture import Frame"),
        ("diffusion.py", "from hyjax import Level"),
        ("shadow.py", "import trimesh"),
        ("cycles.py", "from hyjax.diffusion import diffuse"),
        ("upsampling.py", "from hyjax.cascade import cascade"),
        ("solver.py", "import scipy"),
        ("diffusion.py", "from jaxopt import linear_solve"),
        ("cache.py", "from hyjax.errors import InputError"),
    ],
)
def test_the_import_test_can_fail(place: str, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / place
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"def f():\n    {line.strip()}\n")
    for name in LAYER:
        if name and name not in ("scene", "data"):
            (tmp_path / f"{name}.py").touch()
    path.write_text(f"def f():\n    {line.strip()}\n")
    (tmp_path / "data").mkdir(exist_ok=True)
    (tmp_path / "scene").mkdir(exist_ok=True)
    monkeypatch.setattr(sys.modules[__name__], "PACKAGE", tmp_path)
    assert list(offences(path))


@pytest.mark.parametrize("module", ["hyjax", "hyjax.pipeline"])
def test_import_is_light(module: str) -> None:
    code = f"import sys, {module}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    loaded = {name.split(".")[0] for name in done.stdout.split()}
    heavy = {
        "flax",
        "trimesh",
        "embreex",
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
        lambda: hyjax.diffuse(np.zeros((1, 1, 1)), (np.zeros((0, 1)), np.zeros((1, 0))), [0.1], attachment=-1.0),
        lambda: hyjax.solve(np.zeros((1, 1, 1)), (np.zeros((0, 1)), np.zeros((1, 0))), 0.0),
    ]
    for call in calls:
        with pytest.raises(hyjax.InputError) as caught:
            call()
        assert isinstance(caught.value, ValueError) and "\n" not in str(caught.value)
    assert isinstance(hyjax, types.ModuleType)
