"""Gallery: pages of several captures with an index of thumbnails, a folder for any static host."""

import dataclasses
import itertools
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hyjax.export.settings import ExportSettings
from hyjax.export.single_page import is_single
from hyjax.export.web import THUMBNAIL, check_page_folder, export_web
from hyjax.util.errors import InputError
from hyjax.util.files import write_text
from hyjax.util.templates import templates

INDEX = "index.html"
_TEMPLATES = Path(__file__).parent / "templates"
_MARK = '<link rel="stylesheet" href="gallery.css">'


def export_gallery(settings: ExportSettings) -> list[str]:
    """Write a page for each capture, and the index.

    Pages that are written before one fails are whole; the index is written last.

    Returns:
        Folders of the pages, in `settings.out`.
    """
    folders = folder_names(settings.captures)
    check_gallery_folder(settings.out, folders)
    rooms = []
    for capture, folder in zip(settings.captures, folders, strict=True):
        scene = dataclasses.replace(settings.scene, capture=capture)
        page = export_web(dataclasses.replace(settings, captures=(), scene=scene, out=settings.out / folder))
        rooms.append(_room(page, folder))
    write_text(settings.out / "gallery.css", (_TEMPLATES / "gallery.css").read_text(encoding="utf-8"))
    page_of = templates(_TEMPLATES).get_template("gallery.html.jinja")
    write_text(settings.out / INDEX, page_of.render(rooms=rooms, thumbnail=THUMBNAIL))
    return folders


def folder_names(captures: Sequence[Path]) -> list[str]:
    """Names of folders for captures: their own, as addresses may have them, each once.

    >>> folder_names([Path("My room"), Path("b/kitchen"), Path("kitchen.zip")])
    ['my-room', 'kitchen', 'kitchen-2']
    """
    names: list[str] = []
    for capture in captures:
        own = capture.resolve()
        base = re.sub(r"[^a-z0-9]+", "-", (own.name if own.is_dir() else own.stem).lower()).strip("-") or "room"
        tried = (f"{base}-{number}" for number in itertools.count(2))
        names.append(base if base not in names else next(name for name in tried if name not in names))
    return names


def check_gallery_folder(out: Path, folders: Sequence[str]) -> None:
    """Raise `InputError` unless a gallery can be written there."""
    if is_single(out) or (out.exists() and not out.is_dir()):
        raise InputError(f"{out}: is a file; several pages need a folder; choose another --out")
    index = out / INDEX
    if index.exists() and _MARK not in index.read_text(encoding="utf-8", errors="replace"):
        raise InputError(f"{index}: is no index of a gallery; choose another --out")
    for folder in folders:
        check_page_folder(out / folder)


def _room(page: dict[str, Any], folder: str) -> dict[str, Any]:
    height, width = page["size"]
    return {"folder": folder, "name": page["name"], "frames": len(page["frames"]), "width": width, "height": height}
