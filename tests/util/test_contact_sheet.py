"""The contact sheet: everything in its cell, labelled, nothing beyond [0, 1]."""

from pathlib import Path

import numpy as np

from hyjax.util.contact_sheet import BACKGROUND, GAP, INK, LABEL, contact_sheet, fitted_row, write_contact_sheet
from hyjax.util.images import read_image, to_bytes

WIDTH = 40


def plain(value: float, height: int = 30, width: int = 40) -> np.ndarray:
    return np.full((height, width, 3), value, np.float32)


def cell(sheet: np.ndarray, row: int, column: int, height: int = 30) -> np.ndarray:
    top, left = 2 * LABEL + row * (height + LABEL), GAP + column * (WIDTH + GAP)
    return sheet[top : top + height, left : left + WIDTH]


def test_each_picture_is_in_its_cell() -> None:
    rows = [(f"row {r}", [plain(0.1 + 0.3 * r + 0.1 * c) for c in range(3)]) for r in range(2)]
    sheet = contact_sheet(rows, ("a", "b", "c"), width=WIDTH)
    assert sheet.shape == (LABEL + 2 * (30 + LABEL), 3 * (WIDTH + GAP) + GAP, 3)
    for r in range(2):
        for c in range(3):
            np.testing.assert_allclose(cell(sheet, r, c), 0.1 + 0.3 * r + 0.1 * c, atol=0.6 / 255)


def test_headings_and_labels_are_written_above_the_pictures() -> None:
    sheet = contact_sheet([("000", [plain(0.5)] * 2)], ("iiii", ""), width=WIDTH)
    heading, no_heading = sheet[:LABEL, : GAP + WIDTH], sheet[:LABEL, GAP + WIDTH + 1 :]
    label = sheet[LABEL : 2 * LABEL, : GAP + WIDTH]
    assert heading.max() > 0.6 * INK and label.max() > 0.6 * INK
    np.testing.assert_allclose(no_heading, round(255 * BACKGROUND) / 255, atol=1e-6)
    other = contact_sheet([("001", [plain(0.5)] * 2)], ("iiii", ""), width=WIDTH)[LABEL : 2 * LABEL]
    assert not np.array_equal(other[:, : GAP + WIDTH], label)


def test_pictures_of_any_size_are_resampled_to_the_column() -> None:
    tall = contact_sheet([("x", [plain(0.3, 120, 60)])], ("h",), width=WIDTH)
    assert tall.shape[0] == LABEL + 80 + LABEL
    mixed = contact_sheet([("x", [plain(0.3), plain(0.6, 300, 400)])], ("a", "b"), width=WIDTH)
    np.testing.assert_allclose(cell(mixed, 0, 1), 0.6, atol=0.6 / 255)


def test_values_out_of_range_are_clipped_before_they_ring() -> None:
    picture = plain(0.5, 60, 80)
    picture[:, 40:] = 50.0
    sheet = contact_sheet([("x", [picture])], ("a",), width=WIDTH)
    left = cell(sheet, 0, 0)[:, :15]
    np.testing.assert_allclose(left, 0.5, atol=0.05)


def test_rows_that_were_fitted_before_make_the_same_sheet() -> None:
    row = [np.random.default_rng(0).random((60, 80, 3), np.float32) for _ in range(2)]
    fitted = fitted_row(row, WIDTH)
    assert fitted[0].shape == (30, WIDTH, 3)
    headings = ("a", "b")
    np.testing.assert_array_equal(
        contact_sheet([("x", fitted)], headings, WIDTH), contact_sheet([("x", row)], headings, WIDTH)
    )


def test_write(tmp_path: Path) -> None:
    rows = [("x", [plain(0.25)])]
    write_contact_sheet(tmp_path / "s.png", rows, ("a",))
    np.testing.assert_array_equal(to_bytes(read_image(tmp_path / "s.png")), to_bytes(contact_sheet(rows, ("a",))))
    assert [entry.name for entry in tmp_path.iterdir()] == ["s.png"]


def test_a_picture_of_one_channel_is_grey() -> None:
    sheet = contact_sheet([("x", [plain(0.3), plain(0.6)[..., :1]])], ("a", "b"), width=WIDTH)
    np.testing.assert_allclose(cell(sheet, 0, 1), 0.6, atol=0.6 / 255)
