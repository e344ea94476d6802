"""Pairs of pictures and depth: masks, selection, specs, and every published layout on files as it has them."""

import sys
from pathlib import Path

import numpy as np
import pytest
from common import data_folder
from extras import need
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from reference import pairs_export as export
from refusals import refuses

from hyjax.pairs import registry
from hyjax.pairs.depth_pairs import ChosenPairs, DepthPair, DepthPairs, PairsKind, masked_pair, natural
from hyjax.pairs.folder import open_folder
from hyjax.pairs.registry import open_pairs, register_pairs
from hyjax.util.images import write_png

HEIGHT, WIDTH = 12, 16


def picture(seed: int = 0) -> np.ndarray:
    """8-bit colours as the files keep them."""
    return np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH, 3)) / 255


def metres(seed: int = 0) -> np.ndarray:
    """Whole millimetres, some of them missing."""
    depth = np.random.default_rng(seed).integers(500, 9000, (HEIGHT, WIDTH)) / 1000
    depth[3, 4:9] = 0
    return depth


def disparities(seed: int = 0) -> np.ndarray:
    disparity = np.random.default_rng(seed).integers(60, 200, (HEIGHT, WIDTH)).astype(float)
    disparity[3, 4:9] = 0
    return disparity


def same(pair: DepthPair, image: np.ndarray, depth: np.ndarray, valid: np.ndarray | None = None) -> None:
    """The pair is exactly what was written, masked where `depth` is 0 or `valid` says so."""
    expected = (depth > 0) & (True if valid is None else valid)
    assert pair.image.dtype == pair.depth.dtype == np.float32
    np.testing.assert_allclose(pair.image, image, atol=1e-6)
    np.testing.assert_array_equal(pair.valid, expected)
    np.testing.assert_allclose(pair.depth, np.where(expected, depth, 0), rtol=1e-6)


def refuses_pairs(text: str, *parts: str) -> None:
    """Opening, or reading all pairs, fails with one line that holds all `parts`."""
    refuses(lambda: [pairs[i] for pairs in [open_pairs(text)] for i in range(len(pairs))], *parts)


# ---- masks ----


@given(hnp.arrays(np.float32, (3, 4), elements=st.floats(width=32)))
def test_what_is_no_depth_is_masked(depth: np.ndarray) -> None:
    depth[0, 0] = 2.0
    depth[0, 1:] = (np.nan, np.inf, 0.0)
    pair = masked_pair("a", np.zeros((3, 4, 3)), depth, "metres", where="a", normal=np.ones((3, 4, 3)))
    assert pair.valid[0, 0] and not pair.valid[0, 1:].any()
    assert np.all(np.isfinite(pair.depth)) and np.all((pair.depth > 0) == pair.valid)
    np.testing.assert_array_equal(pair.depth[pair.valid], depth[pair.valid])
    assert pair.normal is not None and np.all((pair.normal != 0).all(axis=-1) == pair.valid)


def test_pairs_that_cannot_be() -> None:
    image, depth = np.zeros((3, 4, 3)), np.ones((3, 4))
    refuses(lambda: masked_pair("a", image, depth[:2], "metres", where="here"), "here", "4x2", "4x3")
    refuses(lambda: masked_pair("a", image, 0 * depth, "metres", where="here"), "here", "no valid depth")
    refuses(lambda: masked_pair("a", image, depth, "feet", where="here"), "here", "'feet'")  # type: ignore[arg-type]


def test_natural_order() -> None:
    assert sorted(["a10", "a2", "10", "b", "a", "2"], key=natural) == ["2", "10", "a", "a2", "a10", "b"]


# ---- a plain folder ----


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Eleven pairs, numbered without leading zeros."""
    path = tmp_path / "pairs"
    for number in range(11):
        export.export_folder(path, f"scene{number}", picture(number), metres(number))
    return path


def test_folder(folder: Path) -> None:
    pairs: DepthPairs = open_pairs(f"folder:{folder}")
    assert (pairs.name, pairs.unit, len(pairs)) == ("pairs", "metres", 11)
    assert pairs[10].name == "scene10"
    same(pairs[2], picture(2), metres(2))


def test_both_markers_mean_no_reading(folder: Path) -> None:
    depth = metres()
    depth[0, 0] = 65.535
    export.export_folder(folder, "scene0", picture(), depth)
    depth[0, 0] = 0
    same(open_pairs(f"mosd:{folder}")[0], picture(), depth)


def test_subfolders(tmp_path: Path) -> None:
    for number in (1, 2):
        export.export_subfolders(tmp_path, f"{number}", picture(number), metres(number))
    pairs = open_pairs(f"folder:{tmp_path}")
    assert len(pairs) == 2
    same(pairs[1], picture(2), metres(2))


@pytest.mark.parametrize(("unit", "step"), [("tenths", 1e-4), ("fifths", 2e-4), ("centimetres", 1e-2)])
def test_units(tmp_path: Path, unit: str, step: float) -> None:
    depth = np.round(metres() / step) * step
    depth[depth > 6] = 0  # tenths of a millimetre reach 6.5 m
    export.export_folder(tmp_path, "a", picture(), depth, step=step)
    same(open_pairs(f"folder:{tmp_path}?unit={unit}")[0], picture(), depth)


def test_folders_that_cannot_be_used(folder: Path, tmp_path: Path) -> None:
    refuses_pairs(f"folder:{tmp_path / 'nowhere'}", "nowhere", "no such folder")
    (tmp_path / "empty").mkdir()
    refuses_pairs(f"folder:{tmp_path / 'empty'}", "empty", "no pairs", "NAME_rgb.png")
    refuses_pairs(f"folder:{folder}?unit=milimetres", "'milimetres'", "did you mean 'millimetres'")


def test_unmatched_pairs_are_named(folder: Path) -> None:
    (folder / "scene10_depth.png").unlink()
    (folder / "scene3_rgb.png").unlink()
    refuses_pairs(f"folder:{folder}", "scene3_depth.png", "no partner")
    (folder / "scene3_depth.png").unlink()
    refuses_pairs(f"folder:{folder}", "scene10_rgb.png", "no partner")


def test_two_pictures_of_one_name(folder: Path) -> None:
    (folder / "scene3_rgb.jpg").touch()
    refuses_pairs(f"folder:{folder}", "scene3_rgb.png", "scene3_rgb.jpg")


def test_damaged_pictures_are_named(folder: Path) -> None:
    export.truncate(folder / "scene4_depth.png")
    refuses_pairs(f"folder:{folder}", "scene4_depth.png", "truncated")
    export.truncate(folder / "scene2_rgb.png")
    refuses_pairs(f"folder:{folder}", "scene2_rgb.png", "truncated")


def test_depth_maps_that_are_none(folder: Path) -> None:
    write_png(folder / "scene1_depth.png", picture()[..., :1])
    refuses_pairs(f"folder:{folder}", "scene1_depth.png", "uint8")
    export.write_grey16(folder / "scene1_depth.png", 1000 * picture())
    refuses_pairs(f"folder:{folder}", "scene1_depth.png", "3")
    export.export_folder(folder, "scene1", picture(), metres()[:5])
    refuses_pairs(f"folder:{folder}", "scene1_depth.png", "16x5", "16x12")
    export.export_folder(folder, "scene1", picture(), 0 * metres())
    refuses_pairs(f"folder:{folder}", "scene1_depth.png", "no valid depth")


def test_fingerprint_knows_content_but_not_place(folder: Path, tmp_path: Path) -> None:
    before = open_pairs(f"folder:{folder}").fingerprint
    moved = folder.rename(tmp_path / "elsewhere")
    assert open_pairs(f"folder:{moved}").fingerprint == before
    chosen = open_pairs(f"folder:{moved}?frames=0:10").fingerprint
    (moved / "scene10_depth.png").unlink()
    (moved / "scene10_rgb.png").unlink()
    assert len({before, chosen, open_pairs(f"folder:{moved}").fingerprint}) == 3


# ---- selection and specs ----


def test_frames_and_without_part_the_pairs(folder: Path) -> None:
    held_out = open_pairs(f"folder:{folder}?frames=3:11:4")
    rest = open_pairs(f"folder:{folder}?without=3:11:4")
    assert isinstance(held_out, ChosenPairs) and held_out.unit == "metres"
    names = [[pairs[i].name for i in range(len(pairs))] for pairs in (held_out, rest)]
    assert names[0] == ["scene3", "scene7"]
    assert names[1] == [f"scene{i}" for i in (0, 1, 2, 4, 5, 6, 8, 9, 10)]
    both = open_pairs(f"folder:{folder}?frames=0:4&without=1")
    assert [both[i].name for i in range(len(both))] == ["scene0", "scene2", "scene3"]


def test_mosd_held_out_scenes() -> None:
    path = data_folder() / "mosd"
    if not path.is_dir():
        pytest.skip(f"no depth pairs in {path}; point HYJAX_DATA at the folder that holds mosd/")
    held_out, rest = (open_pairs(f"mosd:{path}?{word}=3:40:4") for word in ("frames", "without"))
    assert [held_out[i].name for i in range(len(held_out))] == [f"learn{n}" for n in range(3, 40, 4)]
    assert len(rest) == 35
    assert 0.4 < np.median(held_out[0].depth[held_out[0].valid]) < 1.5


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["KIND:PATH", "folder"]),
        ("/data/mosd", ["KIND:PATH"]),
        ("folders:/data", ["did you mean 'folder'", "middlebury"]),
        ("folder:", ["names no file"]),
        ("folder:{}?frame=3", ["'frame=3'", "frames"]),
        ("folder:{}?frames", ["'frames'", "NAME=VALUE"]),
        ("folder:{}?frames=1&frames=2", ["once"]),
        ("folder:{}?frames=50", ["50", "0 to 10"]),
        ("folder:{}?frames=2&without=2", ["leave none"]),
        ("mosd:{}?unit=metres", ["unit=metres"]),
        ("rooms:/data", ["generated"]),
        ("rooms?seed=-1", ["seed=-1", "whole number"]),
        ("rooms?cached=maybe", ["cached=maybe", "yes or no"]),
    ],
)
def test_bad_specs(folder: Path, text: str, parts: list[str]) -> None:
    refuses_pairs(text.format(folder), *parts)


def test_rooms_need_no_file() -> None:
    rooms = open_pairs("rooms?seed=2&size=64&views=2")
    assert rooms.unit == "metres" and len(rooms) > 1 << 20
    few = open_pairs("rooms?seed=2&size=64&views=2&frames=1:3")
    assert len(few) == 2
    assert few.fingerprint != rooms.fingerprint != open_pairs("rooms?seed=3&size=64&views=2").fingerprint


# ---- DIML ----


@pytest.mark.parametrize("whole", [False, True])
def test_diml_indoor(tmp_path: Path, whole: bool) -> None:
    for number in (1, 2):
        scene = tmp_path / "HR" / f"0{number}. Cafe"
        export.export_diml_indoor(scene, "in_00_160315_165831", picture(number), metres(number), whole=whole)
    pairs = open_pairs(f"diml:{tmp_path / 'HR'}")
    assert (len(pairs), pairs.unit, pairs[1].name) == (2, "metres", "02. Cafe/in_00_160315_165831")
    same(pairs[1], picture(2), metres(2))


@pytest.mark.parametrize("whole", [False, True])
def test_diml_outdoor_counts_where_confident(tmp_path: Path, whole: bool) -> None:
    confidence = np.where(np.arange(WIDTH) < 10, 1.0, 0.5) * np.ones((HEIGHT, 1))
    export.export_diml_outdoor(tmp_path, "0001", picture(), metres(), confidence, whole=whole)
    same(open_pairs(f"diml:{tmp_path}")[0], picture(), metres(), confidence > 0.9)


def test_diml_that_cannot_be_used(tmp_path: Path) -> None:
    refuses_pairs(f"diml:{tmp_path}", "no DIML scene", "depth_filled")
    export.export_diml_indoor(tmp_path, "in_1", picture(), metres())
    (tmp_path / "depth_filled" / "in_1_depth_filled.png").rename(
        tmp_path / "depth_filled" / "in_2_depth_filled.png"
    )
    refuses_pairs(f"diml:{tmp_path}", "in_1_c.png", "no partner")
    outdoor = tmp_path / "outdoor"
    export.export_diml_outdoor(outdoor, "0001", picture(), metres(), metres()[:5] / 9)
    refuses_pairs(f"diml:{outdoor}", "confidencemap/0001.png", "16x5", "16x12")


# ---- Middlebury ----


@pytest.mark.parametrize(("view", "map_name"), [("view1", "disp1"), ("view5", "disp5"), ("im2", "disp2")])
def test_middlebury_2003_to_2006(tmp_path: Path, view: str, map_name: str) -> None:
    export.export_middlebury(tmp_path / "Art", view, map_name, picture(), disparities(), dmin=55)
    pairs = open_pairs(f"middlebury:{tmp_path}")
    assert (len(pairs), pairs.unit, pairs[0].name) == (1, "disparity", f"Art/{view}")
    same(pairs[0], picture(), disparities())


def test_middlebury_2014(tmp_path: Path) -> None:
    for view in (0, 1):
        disparity = disparities(view) + 0.25 * (disparities(view) > 0)
        export.export_middlebury_2014(tmp_path / "Piano-perfect", view, picture(view), disparity, doffs=31.086)
    pairs = open_pairs(f"middlebury:{tmp_path / 'Piano-perfect'}")
    assert [pairs[i].name for i in range(2)] == ["im0", "im1"]
    same(pairs[1], picture(1), disparities(1) + 0.25 * (disparities(1) > 0))


def test_middlebury_plain_folder(tmp_path: Path) -> None:
    write_png(tmp_path / "art_rgb.png", picture())
    write_png(tmp_path / "art_disparity.png", disparities()[..., None] / 255)
    pairs = open_pairs(f"middlebury:{tmp_path}")
    assert (len(pairs), pairs.unit, pairs[0].name) == (1, "disparity", "art")
    same(pairs[0], picture(), disparities())


def test_middlebury_that_cannot_be_used(tmp_path: Path) -> None:
    refuses_pairs(f"middlebury:{tmp_path}", "no Middlebury scene", "disp0.pfm")
    scene = tmp_path / "Piano"
    export.export_middlebury_2014(scene, 0, picture(), disparities(), doffs=31.086)
    export.truncate(scene / "disp0.pfm")
    refuses_pairs(f"middlebury:{tmp_path}", "disp0.pfm", "bytes")
    (scene / "disp0.pfm").write_bytes(b"PF\n2 2\n-1\n" + bytes(48))
    refuses_pairs(f"middlebury:{tmp_path}", "disp0.pfm", "one-channel")
    export.export_middlebury_2014(scene, 0, picture(), disparities(), doffs=31.086)
    (scene / "calib.txt").write_text("doffs=many\n")
    refuses_pairs(f"middlebury:{tmp_path}", "calib.txt", "'many'")
    (scene / "im0.png").unlink()
    refuses_pairs(f"middlebury:{tmp_path}", "disp0.pfm", "im0.png")
    write_png(scene / "im0.png", picture())
    (scene / "disp0.pfm").unlink()
    write_png(scene / "disp0.png", picture())
    refuses_pairs(f"middlebury:{tmp_path}", "disp0.png", "one channel")


# ---- NYU Depth v2 ----


def test_nyu(tmp_path: Path) -> None:
    need("nyu")
    file = tmp_path / "nyu_depth_v2_labeled.mat"
    filled = [np.where(metres(n) > 0, metres(n), 1.5) for n in range(3)]
    export.export_nyu(file, [picture(n) for n in range(3)], filled, [metres(n) for n in range(3)])
    pairs = open_pairs(f"nyu:{file}?frames=1:")
    assert (len(pairs), pairs.unit, pairs[0].name) == (2, "metres", "0001")
    same(pairs[0], picture(1), metres(1))


def test_links_that_lead_nowhere_are_no_pictures(folder: Path) -> None:
    before = len(open_pairs(f"folder:{folder}"))
    (folder / "z_rgb.png").symlink_to(folder / "gone.png")
    (folder / "z_depth.png").symlink_to(folder / "gone.png")
    pairs = open_pairs(f"folder:{folder}")
    assert len(pairs) == before and pairs.fingerprint
    export.export_folder(folder, "y", picture(), metres())
    (folder / "y_depth.png").unlink()
    (folder / "y_depth.png").symlink_to(folder / "gone.png")
    refuses_pairs(f"folder:{folder}", "y_rgb.png", "has no partner")


def test_nyu_that_cannot_be_used(tmp_path: Path) -> None:
    need("nyu")
    import h5py

    file = tmp_path / "nyu.mat"
    refuses_pairs(f"nyu:{file}", "nyu.mat", "no such file")
    export.export_nyu(file, [picture()], [metres()], [metres()])
    with h5py.File(file, "a") as stored:
        del stored["rawDepths"]
    refuses_pairs(f"nyu:{file}", "nyu.mat", "'rawDepths'")
    export.export_nyu(file, [picture()], [metres()], [metres()[:5]])
    refuses_pairs(f"nyu:{file}", "nyu.mat", "do not belong together")
    export.export_nyu(file, [picture()], [metres()], [metres()])
    export.truncate(file)
    refuses_pairs(f"nyu:{file}", "nyu.mat", "HDF5")
    file.write_bytes(b"MATLAB 5.0 MAT-file" + bytes(500))
    refuses_pairs(f"nyu:{file}", "nyu.mat", "HDF5")


def test_nyu_without_h5py(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    refuses_pairs(f"nyu:{tmp_path / 'nyu.mat'}", "h5py", "hyjax[nyu]")


def test_a_kind_from_outside_is_opened(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    monkeypatch.setattr(registry, "PAIRS_KINDS", registry.PAIRS_KINDS.copy())
    kind = PairsKind("mine", lambda path, options: open_folder(path, options["steps"]), ("steps",))
    register_pairs(kind)
    assert len(open_pairs(f"mine:{folder}?steps=metres&frames=0:2")) == 2
    refuses(lambda: open_pairs(f"mine:{folder}?unit=metres"), "mine takes steps, frames, without")
    refuses(lambda: open_pairs("min:"), "did you mean 'mine'")
    refuses(lambda: register_pairs(kind), "'mine' is registered already")
