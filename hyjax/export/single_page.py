"""Single file of a page: everything of its folder in one HTML file, which runs by itself when it is opened."""

import base64
import contextlib
import json
import mimetypes
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

from hyjax.util.errors import InputError
from hyjax.util.files import make_writable, write_text

SINGLE_SUFFIX = ".html"
"""Ending of an `--out` that is a single file."""
_GENERATOR = '<meta name="generator" content="hyjax">'
"""Mark of a single file, which another one may replace."""
_POLICY = "default-src data: blob: 'unsafe-inline'"
"""Policy of a file that holds its own scripts, and asks no server for anything."""
_IMPORT = re.compile(r'(from |import\(|import )"\./')
mimetypes.add_type("text/javascript", ".js")  # some systems have none, and browsers run no others
_SOURCE = re.compile(r'(href|src)="([\w.]+)"')


def is_single(out: Path) -> bool:
    """Whether a page is to be a single file, by its ending."""
    return out.suffix.lower() == SINGLE_SUFFIX


def check_single_file(out: Path) -> None:
    """Raise `InputError` unless a single file can be written there: nothing is, or an earlier one."""
    if out.is_dir():
        raise InputError(f"{out}: is a folder; choose another --out")
    make_writable(out.parent)
    if out.exists() and _GENERATOR not in out.read_text(encoding="utf-8", errors="replace"):
        raise InputError(f"{out}: is no page of hyjax; choose another --out")


@contextlib.contextmanager
def new_single_page(out: Path) -> Iterator[Path]:
    """Folder for a page that becomes a single file when it is complete, and goes."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)
        write_text(out, single_page(Path(folder)))


def single_page(folder: Path) -> str:
    """HTML file of everything in a page's folder.

    Scripts find each other by an import map, and the page its data by their names, see `read` of scene.js.
    """
    files = (path for path in folder.rglob("*") if path.is_file())
    content = {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}
    html, style = (content.pop(name).decode() for name in ("index.html", "style.css"))
    imports = {}
    for name in [name for name in content if name.endswith(".js")]:
        script = _IMPORT.sub(r'\1"hyjax/', content.pop(name).decode())
        imports[f"hyjax/{name}"] = _data_url(name, script.encode())
    data = {name: _data_url(name, each) for name, each in content.items() if not name.endswith(".md")}
    read = {name: url.partition(",")[2] for name, url in data.items() if f'"{name}"' not in html}
    scripts = (
        _json_script("importmap", {"imports": imports}),
        _json_script('application/json" id="files', read),
        '<script type="module">import "hyjax/main.js";</script>',
    )
    for old, new in {
        "content=\"default-src 'self'\">": f'content="{_POLICY}">\n{_GENERATOR}',
        '<link rel="stylesheet" href="style.css">': f"<style>\n{style}</style>",
        '<script type="module" src="main.js"></script>': "\n".join(scripts),
    }.items():
        assert html.count(old) == 1, old
        html = html.replace(old, new)
    return _SOURCE.sub(lambda found: f'{found[1]}="{data[found[2]]}"', html)


def _data_url(name: str, content: bytes) -> str:
    kind = mimetypes.guess_type(name)[0] or "application/octet-stream"
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def _json_script(kind: str, content: object) -> str:
    text = json.dumps(content).replace("<", "\\u003c")  # a name may hold what ends a script
    return f'<script type="{kind}">{text}</script>'
