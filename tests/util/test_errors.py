"""Messages: one line of bounded length, whatever is in it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyjax.util.errors import LONGEST_MESSAGE, did_you_mean, one_line


@given(st.text())
def test_short_texts_keep_what_can_be_shown(text: str) -> None:
    assert one_line(text).isprintable()
    assert not text.isprintable() or one_line(text) == text


@pytest.mark.parametrize("letter", ["a", "\n", "\x00", "\u200b", "\U000e0001"])
@pytest.mark.parametrize("count", [LONGEST_MESSAGE // 4, LONGEST_MESSAGE + 1, 100_000])
def test_long_texts_keep_their_ends_within_the_limit(letter: str, count: int) -> None:
    line = one_line(f"begin{letter * count}end")
    assert line.isprintable() and len(line) <= LONGEST_MESSAGE
    assert line.startswith("begin") and line.endswith("end")


@pytest.mark.parametrize(
    ("word", "known", "meant"),
    [
        ("noon", ["night-moon", "noon-window"], "noon-window"),
        ("posit", ["position_of_lamp", "position"], "position"),
        ("centre", ["evening-lamps", "center-point"], "center-point"),
        ("lumens", ["luminous_flux", "color"], "luminous_flux"),
        ("l1", ["mean_abs", "l2"], "l2"),
        ("cube", ["true", "captured"], None),
        ("maybe", ["yes", "no"], None),
    ],
)
def test_the_nearest_word_is_suggested(word: str, known: list[str], meant: str | None) -> None:
    assert did_you_mean(word, known) == (f" (did you mean {meant!r}?)" if meant else "")
