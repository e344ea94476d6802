"""Files of captures, in folders and in archives. An archive from a stranger can lead nowhere else."""

import contextlib
import os
import stat
import tracemalloc
import zipfile
from pathlib import Path

import pytest

from hyjax.data import trees
from hyjax.data.capture_files import by_number
from hyjax.data.registry import open_capture
from hyjax.data.trees import open_tree
from hyjax.util.errors import InputError

FILES = {"a.txt": b"one", "depth/0.bin": b"x" * 300, "depth/1.bin": b"y" * 200, "depth/far/2.bin": b""}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, content in FILES.items():
        file = tmp_path / "capture" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)
    return tmp_path / "capture"


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    path = tmp_path / "capture.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in FILES.items():
            file.writestr(name, content)
        file.writestr("__MACOSX/._a.txt", b"of another system")
    return path


@pytest.mark.parametrize("kind", ["folder", "archive"])
def test_folders_and_archives_are_read_alike(kind: str, request: pytest.FixtureRequest) -> None:
    tree = open_tree(request.getfixturevalue(kind))
    assert tree.names == tuple(sorted(FILES))
    assert {name: tree.read(name) for name in tree.names} == FILES
    assert [tree.size(name) for name in tree.names] == [len(FILES[name]) for name in tree.names]
    assert tree.below("depth") == ["depth/0.bin", "depth/1.bin"] and tree.below("", ".TXT") == ["a.txt"]
    assert tree.folders() == ["depth"] and "a.txt" in tree and "b.txt" not in tree
    assert tree.ends("depth/0.bin", 2) == (b"xx", b"xx") and tree.ends("a.txt", 64) == (b"one", b"one")
    with tree.local("depth/1.bin") as path:
        assert path.name == "1.bin" and path.read_bytes() == FILES["depth/1.bin"]
    for _ in range(2):
        with tree.stream("depth/0.bin") as file:
            assert file.seek(298) == 298 and file.read() == b"xx"
    with pytest.raises(InputError, match="no such file"), tree.stream("b.txt"):
        pass
    below = tree.subtree("depth")
    with below.stream("1.bin") as file:
        assert file.read(2) == b"yy"
    assert below.names == ("0.bin", "1.bin", "far/2.bin") and below.read("0.bin") == FILES["depth/0.bin"]
    assert len({tree.fingerprint(), below.fingerprint()}) == 2
    with pytest.raises(InputError, match=r"b\.txt: no such file"):
        tree.read("b.txt")


def test_fingerprints_follow_the_content(folder: Path) -> None:
    before = open_tree(folder).fingerprint()
    assert open_tree(folder).fingerprint() == before
    (folder / "a.txt").write_bytes(b"other")
    assert open_tree(folder).fingerprint() != before


def _archive_with(path: Path, name: str, content: bytes = b"x", mode: int = 0o644) -> Path:
    entry = zipfile.ZipInfo(name)
    entry.external_attr = mode << 16
    entry.compress_type = zipfile.ZIP_DEFLATED
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("a.txt", b"one")
        file.writestr(entry, content)
    return path


@pytest.mark.parametrize("name", ["/etc/passwd", "../up.txt", "a/../../up.txt", "C:/up.txt", "\\up.txt", "..\\up"])
def test_names_that_lead_out_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"bad\.zip: refused, .*leads out"):
        open_tree(_archive_with(tmp_path / "bad.zip", name))


def test_links_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="refused, it holds a link, 'way_out'"):
        open_tree(_archive_with(tmp_path / "bad.zip", "way_out", b"/etc/passwd", stat.S_IFLNK | 0o777))


def test_bombs_are_refused_before_they_are_unpacked(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"refused, 'bomb' unpacks to 64 MiB"):
        open_tree(_archive_with(tmp_path / "bad.zip", "bomb", bytes(1 << 26)))


def test_what_is_packed_behind_a_files_size_is_never_unpacked(tmp_path: Path) -> None:
    path = _archive_with(tmp_path / "bad.zip", "bomb", bytes(1 << 26))
    content = path.read_bytes()
    path.write_bytes(content.replace((1 << 26).to_bytes(4, "little"), (10).to_bytes(4, "little")))
    tree = open_tree(path)
    tracemalloc.start()
    with contextlib.suppress(InputError):  # its checksum is another one
        tree.read("bomb")
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 1 << 22


def test_many_small_bombs_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "bad.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for number in range(4):
            file.writestr(f"{number}.jpg", bytes(1 << 24))
    with pytest.raises(InputError, match=r"refused, its files unpack to 64 MiB"):
        open_tree(path)


def test_packings_without_a_bound_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "bad.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as file:
        file.writestr("a.txt", b"one")
    with pytest.raises(InputError, match=r"'a\.txt' is packed by method 14"):
        open_tree(path)


@pytest.mark.parametrize("name", [".", "./."])
def test_files_without_a_name_are_no_crash(tmp_path: Path, name: str) -> None:
    open_tree(_archive_with(tmp_path / "odd.zip", name))


def test_linked_folders_are_followed_but_not_in_circles(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "b.txt").write_bytes(b"two")
    (folder / "linked").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere" / "back").symlink_to(folder)
    assert open_tree(folder).names == tuple(sorted([*FILES, "linked/b.txt"]))


def test_names_that_are_no_utf8_have_a_fingerprint(folder: Path) -> None:
    (folder / os.fsdecode(b"\xff.txt")).write_bytes(b"")
    assert len(open_tree(folder).fingerprint()) == 64


def test_an_archive_with_a_file_without_name_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("b", "x")
    content = (tmp_path / "a.zip").read_bytes()
    at = content.index(b"PK\x01\x02")
    (tmp_path / "a.zip").write_bytes(content[: at + 28] + b"\0" + content[at + 29 :])
    with pytest.raises(InputError, match=r"a\.zip: "):
        open_tree(tmp_path / "a.zip")


def test_a_folder_of_everything_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trees, "MOST_FILES", 3)
    with pytest.raises(InputError, match="holds over 3 files; give the folder of one capture"):
        open_tree(folder)


def test_text_that_is_too_large_is_refused(folder: Path) -> None:
    with pytest.raises(InputError, match=r"a\.txt: has over"):
        open_tree(folder).text("a.txt", 2)


def test_numbers_of_any_length_are_sorted() -> None:
    names = ["a" + "1" * 9000, "a10", "a9", "a009"]
    assert sorted(names, key=by_number) == ["a9", "a009", "a10", names[0]]


def test_folders_in_folders_without_end_are_one_line(tmp_path: Path) -> None:
    path = tmp_path / "deep.zip"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("a/" * 3000 + "rgb.txt", b"")
    with pytest.raises(InputError, match="not a known capture layout"):
        open_capture(path)


def test_a_file_twice_is_refused(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="Duplicate name"):
        path = _archive_with(tmp_path / "bad.zip", "a.txt")
    with pytest.raises(InputError, match="two files have the same name"):
        open_tree(path)


def test_damaged_archives_are_one_line(archive: Path) -> None:
    content = archive.read_bytes()
    archive.write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match=r"capture\.zip: not a readable ZIP archive"):
        open_tree(archive)
    start = content.index(b"depth/0.bin") + len(b"depth/0.bin")
    archive.write_bytes(
        content[:start] + bytes(b ^ 0x55 for b in content[start : start + 4]) + content[start + 4 :]
    )
    with pytest.raises(InputError, match=r"depth/0\.bin: damaged in the archive"):
        open_tree(archive).read("depth/0.bin")


def test_nothing_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        open_tree(tmp_path / "none")
    with pytest.raises(InputError, match="no such folder"):
        open_tree(tmp_path / ("n" * 300))
    (tmp_path / "scanned_chair").mkdir()
    with pytest.raises(InputError, match=r"no such folder \(did you mean 'scanned_chair'\?\)"):
        open_tree(tmp_path / "scanned_chiar")
    with pytest.raises(InputError, match="no such folder;"):
        open_tree(tmp_path / "nowhere" / "scanned_chair")
