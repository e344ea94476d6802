"""Single file of a page: it holds all that its folder holds, and asks for nothing."""

import base64
import json
import re
from pathlib import Path

import pytest

from hyjax.device.page_content import page_scripts
from hyjax.export.single_page import is_single, new_single_page
from hyjax.export.web import check_page_folder
from hyjax.util.errors import InputError

ODD = "frames/<!--<script>.jpg"
FILES = {"page.json": b"{}", "scene.bin": bytes(range(256)), ODD: b"0", "contact_sheet.png": b"1"}


@pytest.fixture
def html(tmp_path: Path) -> str:
    file = tmp_path / "room.html"
    with new_single_page(file) as folder:
        for name, content in (*page_scripts(), *FILES.items(), ("README.md", b"")):
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_bytes(content)
    check_page_folder(file)  # another page may take its place
    return file.read_text()


def content(url: str) -> bytes:
    head, _, packed = url.partition(",")
    assert head.startswith("data:") and head.endswith(";base64")
    return base64.b64decode(packed)


def test_its_scripts_find_each_other(html: str) -> None:
    (found,) = re.findall(r'<script type="importmap">(.*?)</script>', html)
    modules = {name: content(url).decode() for name, url in json.loads(found)["imports"].items()}
    written = dict(page_scripts())
    assert set(modules) == {f"hyjax/{name}" for name in written if name.endswith(".js")}
    wanted = 0
    for text in modules.values():
        assert not re.search(r"""(from|import\(?)\s*["']\./""", text), "a data URL has no folder"
        for name in re.findall(r"""(?:from |import\()"(hyjax/[^"]+)\"""", text):
            wanted += name in modules
            assert name in modules
    assert wanted > 40


def test_its_data_is_what_the_folder_had_and_nothing_else_is_asked_for(html: str) -> None:
    (found,) = re.findall(r'<script type="application/json" id="files">(.*?)</script>', html)
    held = {name: base64.b64decode(packed) for name, packed in json.loads(found).items()}
    assert held == {name: FILES[name] for name in ("page.json", "scene.bin", ODD)}
    sources = re.findall(r'(?:src|href)="([^"]*)"', html)
    assert sources and all(source.startswith("data:") for source in sources)
    assert "default-src data: blob: 'unsafe-inline'" in html and "'self'" not in html
    assert dict(page_scripts())["style.css"].decode() in html


def test_it_takes_no_other_files_place(tmp_path: Path) -> None:
    assert is_single(Path("Room.HTML")) and not is_single(Path("page"))
    letter = tmp_path / "letter.html"
    letter.write_text("<p>Dear</p>")
    with pytest.raises(InputError, match="no page of hyjax"):
        check_page_folder(letter)
    (tmp_path / "folder.html").mkdir()
    with pytest.raises(InputError, match="is a folder"):
        check_page_folder(tmp_path / "folder.html")
    with pytest.raises(InputError, match="cannot write"):
        check_page_folder(letter / "room.html")
    with pytest.raises(RuntimeError), new_single_page(tmp_path / "none.html"):
        raise RuntimeError
    assert not (tmp_path / "none.html").exists()
