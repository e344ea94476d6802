"""Templates of pages that the commands write."""

from pathlib import Path

import jinja2


def templates(*folders: Path) -> jinja2.Environment:
    """Templates of folders, which escape everything that is not markup already."""
    loader = jinja2.FileSystemLoader(folders)
    return jinja2.Environment(
        loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
