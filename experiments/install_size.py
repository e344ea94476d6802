"""Size of a bare installation, by package, and what of it hyjax adds to the frameworks that it is built on.

    python -m experiments.install_size [--out results/install_size]

Makes an environment of its own, installs this checkout there as README's first command does, and adds up the files
of each package, with the bytecode that pip leaves.

Takes half a minute of a processor, and the network.

Expect: three quarters are JAX, Flax, Optax, JAXopt, NumPy, trimesh, scikit-image, OpenImageIO, and what these need.
"""

import dataclasses
import json
import resource
import subprocess
import tempfile
import venv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from experiments.blocks import Block, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.records import ROOT, Row, of_kind

FRAMEWORKS = ("jax", "flax", "optax", "jaxopt", "numpy", "trimesh", "scikit-image", "openimageio")
MEASURE = """
import importlib.metadata, json, re
found = {}
for one in importlib.metadata.distributions():
    paths = [one.locate_file(file) for file in one.files or []]
    needs = [re.match("[\\\\w.-]+", text)[0] for text in one.requires or [] if "extra ==" not in text]
    names = [re.sub("[-_.]+", "-", name).lower() for name in [one.name, *needs]]
    found[names[0]] = {"bytes": sum(path.stat().st_size for path in paths if path.is_file()), "needs": names[1:]}
print(json.dumps(found))
"""
"""Program that prints the packages of an environment."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(RunConfig):
    least: float = 10.0
    """Megabytes of a package that gets a line of its own."""


@experiment("Size of an installation", "package")
def main(config: Config, start: Start) -> None:
    results = start()
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder, with_pip=True)
        python = str(Path(folder) / "bin" / "python")
        before = _processor_seconds()
        install = [python, "-m", "pip", "install", "--quiet", ".", "-c", "constraints.txt"]
        subprocess.run(install, cwd=ROOT, check=True)
        results.add(kind="install", cpu=_processor_seconds() - before)
        made = subprocess.run([python, "-c", MEASURE], check=True, capture_output=True, text=True).stdout
    found = {name: one for name, one in json.loads(made).items() if name not in ("pip", "setuptools")}
    frameworks = closure(found)
    for name, one in found.items():
        results.add(kind="package", name=name, megabytes=one["bytes"] / 1e6, framework=name in frameworks)


def _processor_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def closure(found: dict[str, Any]) -> set[str]:
    """The frameworks, and all that they need."""
    needed, new = set[str](), set(FRAMEWORKS)
    while new:
        needed |= new
        new = {need for name in new for need in found.get(name, {"needs": []})["needs"]} - needed
    return needed & set(found)


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table from the rows."""
    (took,), packages = of_kind(rows, "install"), of_kind(rows, "package")
    lines = []
    for framework, heading in ((True, "frameworks and what they need"), (False, "besides, for hyjax")):
        part = sorted((row for row in packages if row["framework"] is framework), key=lambda row: -row["megabytes"])
        large = [row for row in part if row["megabytes"] >= took["settings"]["least"]]
        lines.append([f"**{heading}**", f"**{sum(row['megabytes'] for row in part):.0f}**"])
        lines += [[row["name"], f"{row['megabytes']:.0f}"] for row in large]
        lines.append(
            [f"{len(part) - len(large)} others", f"{sum(row['megabytes'] for row in part if row not in large):.0f}"]
        )
    lines.append(["**all**", f"**{sum(row['megabytes'] for row in packages):.0f}**"])
    caption = (
        f"Megabytes of an installation, by package; it took {took['cpu']:.0f} s of a processor. "
        f"*Frameworks*: {', '.join(FRAMEWORKS)}."
    )
    return [Table(caption, ["package", "MB"], lines)]


if __name__ == "__main__":
    run(main)
