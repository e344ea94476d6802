"""Export of one function for one runtime: convert, check against JAX, write."""

from collections.abc import Mapping
from pathlib import Path

from hyjax.export.artifact import Artifact, say
from hyjax.export.graph import build_graph, check_parity
from hyjax.export.readme import write_readme
from hyjax.export.settings import ExportSettings
from hyjax.export.targets import open_target
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError
from hyjax.util.files import atomic_write, make_writable, new_folder, write_text


@checked_arguments
def export_file(settings: ExportSettings) -> Path:
    """Write a function's file for a runtime, and its README.md; the folder of both.

    Args:
        settings: with a runtime as the target.

    Raises:
        InputError: settings that cannot be used, a missing package, a converter that refuses, or a result that
            differs from JAX's; then nothing is written.
    """
    settings.check()
    settings.open_configuration().followed_by("file")
    if settings.out.is_file():
        raise InputError(f"{settings.out}: is a file; a folder is written; choose another --out")
    target = open_target(settings.to)
    graph = build_graph(settings)
    size = "x".join(str(n) for n in reversed(settings.shape))
    say(f"converting {graph.name} ({graph.origin}) at {size}", quiet=settings.quiet)
    artifact: Artifact = target.convert(graph, settings.triple)
    parity = None
    if artifact.run is None:
        say(f"not checked here: {artifact.unchecked}", quiet=settings.quiet)
    else:
        say("comparing with JAX", quiet=settings.quiet)
        parity = check_parity(graph, artifact.run, settings.to)
        say(f"differs from JAX by {parity:.1e} of the value range", quiet=settings.quiet)
    folder = settings.out / f"{settings.what}-{settings.to}"
    text = write_readme(graph, artifact, target=settings.to, packages=target.PACKAGES, parity=parity)
    make_writable(folder)
    write_files(folder, artifact.files)
    write_text(folder / "README.md", text)
    return folder


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files into a folder, each whole; those in a folder of their own appear together with it."""
    for top in dict.fromkeys(name.partition("/")[0] for name in files):
        inside = {name: content for name, content in files.items() if name.partition("/")[0] == top}
        if top in inside:
            with atomic_write(folder / top) as temporary:
                temporary.write_bytes(inside[top])
        else:
            with new_folder(folder / top, replace=True) as temporary:
                for name, content in inside.items():
                    file = temporary / name.partition("/")[2]
                    file.parent.mkdir(parents=True, exist_ok=True)
                    file.write_bytes(content)
