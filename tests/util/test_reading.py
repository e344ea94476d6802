"""Texts, JSON and YAML of files that are damaged, endless, or no files at all."""

import json
import os
import stat
from pathlib import Path

import numpy as np
import pytest
from fuzz.cases import Peak
from hypothesis import given
from hypothesis import strategies as st

from hyjax.configuration import Configuration
from hyjax.data.light_file import read_lights
from hyjax.data.trees import open_tree
from hyjax.geometry.camera import Intrinsics, check_pose
from hyjax.geometry.mesh import load_mesh
from hyjax.guide.weights import read_weights
from hyjax.relighting.settings import read_schedule
from hyjax.tuning.device_latency import read_latency
from hyjax.util import reading
from hyjax.util.errors import InputError
from hyjax.util.images import read_image
from hyjax.util.reading import (
    DEEPEST_NESTING,
    exists,
    finite,
    open_regular,
    parse_json,
    parse_yaml,
    read_bytes,
    read_json,
    read_yaml,
)
from hyjax.util.run_log import read_lines

BOMB = "a0: &a0 [1, 2]\n" + "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12))
"""Aliases of aliases, which stand for 9^11 values."""
JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


@given(value=JSON)
def test_what_json_writes_comes_back(value: object) -> None:
    assert parse_json(json.dumps(value), "a.json") == value
    assert parse_json(json.dumps(value, ensure_ascii=False), "a.json", only_finite=True) == value


@pytest.mark.parametrize(
    "text, says",
    [
        ("[" * 100_000, "64 deep"),
        ("[" * (DEEPEST_NESTING + 1) + "]" * (DEEPEST_NESTING + 1), "64 deep"),
        ('{"a":' * 100_000, "64 deep"),
        ("9" * 5000, "whole number of 5000 digits; at most 20"),
        (str(2**64), "beyond 64 bits"),
        ('{"a": -' + "9" * 400 + "}", "digits"),
        ('["\\ud800"]', "lone surrogate"),
        ("{", "line 1"),
        ("", "not JSON"),
    ],
)
def test_json_that_no_program_writes_is_one_line(text: str, says: str) -> None:
    with pytest.raises(InputError, match=f"a.json: .*{says}"):
        parse_json(text, "a.json")


@pytest.mark.parametrize("text", ["NaN", "[1, -Infinity]", "1e999"])
def test_numbers_that_are_not_finite_can_be_refused(text: str) -> None:
    parse_json(text, "a.json")
    with pytest.raises(InputError, match=r"a\.json: not JSON"):
        parse_json(text, "a.json", only_finite=True)


@pytest.mark.parametrize(
    "text",
    [
        *("2026-99-99", "!!int x", "!!bool x", "0b_", "!!timestamp x", "!!python/object:os.system x", "9" * 5000),
        *("[" * 2000 + "]" * 2000, "- " * 2000 + "1", "1" + "0" * 400, '"\\ud800"', "a: [", "&a [*a]", "{[1]: 2}"),
        BOMB,
    ],
)  # fmt: skip
def test_yaml_that_nobody_writes_is_one_line(text: str) -> None:
    with pytest.raises(InputError, match=r"a\.yaml: "):
        parse_yaml(text, "a.yaml")


@pytest.mark.parametrize("key", ["<<", "! '<<'", "!!merge x", "? <<\n  "])
def test_merge_keys_are_refused_before_they_are_expanded(key: str) -> None:
    bomb = "".join(f"a{k}: &a{k}\n  {key}: [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 4))
    with pytest.raises(InputError, match="merge key"):
        parse_yaml(f"a0: &a0 {{x: 1}}\n{bomb}", "a.yaml")
    assert parse_yaml("'<<': 1", "a.yaml") == {"<<": 1}


def test_whole_numbers_of_64_bits_are_read() -> None:
    assert parse_json("[18446744073709551615]", "a.json") == parse_yaml("[18446744073709551615]", "a.yaml")
    with pytest.raises(InputError, match="64 bits"):
        parse_yaml("18446744073709551616", "a.yaml")


def readers() -> dict[str, object]:
    return {
        "bytes": read_bytes,
        "json": read_json,
        "yaml": read_yaml,
        "image": read_image,
        "schedule": read_schedule,
        "configuration.json": lambda path: Configuration.open(str(path)),
        "latency": read_latency,
        "lights": lambda path: read_lights(path, [0, 0, 1]),
        "mesh.ply": load_mesh,
        "weights": read_weights,
        "archive.zip": open_tree,
        "log": lambda path: read_lines(path, lambda line: True, "a line"),
    }


@pytest.mark.parametrize("name", readers())
def test_pipes_and_folders_are_refused_and_not_waited_for(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    os.mkfifo(path)
    with pytest.raises(InputError, match="pipe"):
        readers()[name](path)  # type: ignore[operator]
    if name != "archive.zip":  # a folder is a tree
        path.unlink()
        path.mkdir()
        with pytest.raises(InputError, match="is a folder"):
            readers()[name](path)  # type: ignore[operator]


def test_endless_files_are_refused(tmp_path: Path) -> None:
    assert stat.S_ISCHR(Path("/dev/zero").stat().st_mode)
    with pytest.raises(InputError, match="device"):
        read_bytes(Path("/dev/zero"))
    (tmp_path / "long").write_bytes(b"x" * 11)
    with pytest.raises(InputError, match="has over 10 bytes"):
        read_bytes(tmp_path / "long", most=10)
    with pytest.raises(InputError, match="leads to a file that the kernel makes up, not a stored one"):
        read_bytes(Path("/proc/self/status"))


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="no file here fails as a disk does")
def test_a_disk_that_fails_while_it_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first page of a process cannot be read."""
    monkeypatch.setattr(reading, "_kernel_devices", set)
    with open_regular(Path("/proc/self/mem"), "room.ply") as file:
        with pytest.raises(InputError, match=r"^room\.ply: cannot read \(Input/output error\)$"):
            file.read(12)
        with pytest.raises(InputError, match=r"^room\.ply: cannot read \(Input/output error\)$"):
            file.read()


def test_names_that_no_file_can_have(tmp_path: Path) -> None:
    for name in ("x" * 5000, "a\0b"):
        assert not exists(tmp_path / name)
        with pytest.raises(InputError):
            read_bytes(tmp_path / name)
    assert exists(tmp_path)


@pytest.mark.parametrize("value", [True, "1", None, float("nan"), float("inf"), [1], 10**400, -1, 11])
def test_numbers_are_numbers_within_their_range(value: object) -> None:
    assert finite(3, "x", least=0, most=10) == 3.0
    with pytest.raises(InputError, match="x: must be"):
        finite(value, "x", least=0, most=10)


@pytest.mark.parametrize(
    "change", [{"fx": 1e-300}, {"fy": 1e-4}, {"fx": 1e300}, {"cx": 1e300}, {"cy": -1e9}, {"width": 1 << 40}]
)
def test_intrinsics_of_no_camera_are_refused(change: dict[str, float]) -> None:
    values = {"width": 640, "height": 480, "fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0}
    Intrinsics(**values)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"(intrinsics|fx|cx): "):
        Intrinsics(**(values | change))  # type: ignore[arg-type]


def test_poses_at_the_end_of_the_world_are_refused() -> None:
    pose = np.eye(4)
    pose[0, 3] = 1e12
    with pytest.raises(InputError, match="at most 1e"):
        check_pose(pose)
    pose[0, 0] = 1e300
    with pytest.raises(InputError):
        check_pose(pose)


def test_a_json_of_too_many_values_is_refused_before_it_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "MOST_MARKS", 100)
    assert parse_json("[" + "0," * 98 + "0]", "a.json")
    for text in ("[" + "[]," * 60 + "[]]", '[{"a":' * 40 + "0" + "}]" * 40):
        with pytest.raises(InputError, match=r"^a\.json: has over 100 values"):
            parse_json(text, "a.json")


@pytest.mark.slow  # in a second, but a worker of README's command shall stay below 1.5 GiB
def test_a_json_text_of_one_wide_letter_is_bounded() -> None:
    """It makes four bytes of each letter: in the text, in the value, and where its surrogates are looked at."""
    text, end = b'["\\ud83d\\ude00', b'"]'
    peak = Peak()
    assert parse_json(text + b"a" * (reading.LARGEST_JSON - len(text) - len(end)) + end, "a.json")
    assert peak.mib() < 1024
    with pytest.raises(InputError, match=r"^a\.json: has over 64 MiB"):
        parse_json(text + b"a" * reading.LARGEST_JSON + end, "a.json")
