"""A gallery of pages: its folders and its index."""

import sys
from pathlib import Path
from typing import Any

import pytest
from page_checks import RUDE

from hyjax import cli
from hyjax.device.serve import ServeSettings, open_folder
from hyjax.export import gallery
from hyjax.export.bench import write_bench
from hyjax.export.gallery import export_gallery, folder_names
from hyjax.export.settings import ExportSettings
from hyjax.export.web import THUMBNAIL
from hyjax.tuning.device_latency import DeviceWorkload
from hyjax.util.errors import InputError


@pytest.fixture
def exported(monkeypatch: pytest.MonkeyPatch) -> list[Path | None]:
    """Captures that pages are written of: folders with nothing but their marks."""
    captures: list[Path | None] = []

    def export_web(settings: ExportSettings) -> dict[str, Any]:
        captures.append(settings.scene.capture)
        settings.out.mkdir(parents=True, exist_ok=True)
        (settings.out / "page.json").write_text('{"made_by": "hyjax"}')
        return {"name": f"Room {len(captures)} {RUDE}", "size": [3, 4], "frames": [{}] * len(captures)}

    monkeypatch.setattr(gallery, "export_web", export_web)
    return captures


def test_captures_get_a_page_each_and_an_index(
    exported: list[Path | None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, captures = tmp_path / "site", [Path("A"), Path("b/B c.zip"), Path("c/a")]
    arguments = ["hyjax", "export", *map(str, captures), "--to", "web", "--out", str(out)]
    monkeypatch.setattr(sys, "argv", arguments)
    cli.main()
    assert exported == captures and "hyjax serve" in capsys.readouterr().out
    index = (out / "index.html").read_text()
    for folder in ("a", "b-c", "a-2"):
        assert (out / folder / "page.json").is_file()
        assert f'href="{folder}/index.html"' in index and f'src="{folder}/{THUMBNAIL}"' in index
    assert RUDE not in index and "Room 3" in index and "1 frame<" in index
    assert (out / "gallery.css").is_file() and "http:" not in index and "https:" not in index
    export_gallery(ExportSettings(to="web", captures=tuple(captures), out=out))  # in the place of the earlier one


def test_what_is_no_gallery_is_left_alone(exported: list[Path | None], tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text("my own")
    with pytest.raises(InputError, match="no index of a gallery"):
        export_gallery(ExportSettings(to="web", captures=(Path("a"),), out=tmp_path))
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "letter.txt").write_text("dear")
    (tmp_path / "index.html").unlink()
    with pytest.raises(InputError, match="holds no page"):
        export_gallery(ExportSettings(to="web", captures=(Path("a"),), out=tmp_path))
    assert not exported


def test_names_of_folders_are_addresses() -> None:
    assert folder_names([Path("Küche"), Path("küche"), Path("§"), Path("x/a-2"), Path("a"), Path("a.zip")]) == [
        "k-che",
        "k-che-2",
        "room",
        "a-2",
        "a",
        "a-3",
    ]


def test_captures_go_with_pages_alone() -> None:
    with pytest.raises(InputError, match="go with --to web only"):
        ExportSettings(to="onnx", captures=(Path("a"),)).check()


def test_the_folder_that_times_a_device_opens_by_itself(tmp_path: Path) -> None:
    folder = write_bench(tmp_path / "bench", DeviceWorkload(height=48, width=64, lights=2))
    assert "measure.js" in (folder / "index.html").read_text() and (folder / "measure.js").is_file()
    server = open_folder(ServeSettings(folder, port=0))
    server.stop()
