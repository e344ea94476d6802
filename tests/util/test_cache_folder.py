"""The bound on what is kept in the cache folder."""

import os
import tempfile
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from hyjax.util.cache import remove_oldest, touch


@given(st.lists(st.integers(0, 50), max_size=8), st.integers(0, 120))
def test_what_was_used_last_stays(sizes: list[int], most: int) -> None:
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "other.txt").write_bytes(bytes(500))
        for number, size in enumerate(sizes):
            (folder / f"{number}.kept").write_bytes(bytes(size))
            os.utime(folder / f"{number}.kept", (number, number))
        remove_oldest(folder, "*.kept", most)
        left = sorted(int(file.stem) for file in folder.glob("*.kept"))
        newest = [number for number in range(len(sizes)) if sum(sizes[number:]) <= most]
        assert left == newest and (folder / "other.txt").is_file()


def test_a_file_that_is_used_is_not_the_oldest(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).write_bytes(bytes(10))
        os.utime(tmp_path / name, (1, 1))
    touch(tmp_path / "a")
    remove_oldest(tmp_path, "*", 10)
    assert [file.name for file in tmp_path.iterdir()] == ["a"]
