"""JSON content with something wrong in it, for property tests."""

import copy
from typing import Any

from hypothesis import strategies as st

WRONG = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.integers(10**20, 10**40),
    st.floats(),
    st.text(max_size=5),
    st.lists(st.floats(allow_nan=True), max_size=4),
    st.just({}),
    st.just([[1, 2], "x"]),
)


@st.composite
def mutated(draw: st.DrawFn, content: Any) -> Any:
    """A copy with one to three values, at any depth, replaced or removed."""
    content = copy.deepcopy(content)
    for _ in range(draw(st.integers(1, 3))):
        place, holder = None, content
        while isinstance(holder, dict | list) and holder:
            keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
            place = holder, draw(st.sampled_from(keys))
            if draw(st.booleans()):
                break
            holder = place[0][place[1]]
        if place is None:
            return copy.deepcopy(draw(WRONG))
        if draw(st.booleans()):
            place[0][place[1]] = copy.deepcopy(draw(WRONG))
        else:
            del place[0][place[1]]
    return content


@st.composite
def mutated_text(draw: st.DrawFn, text: str) -> str:
    """A copy with a stretch replaced by something short."""
    start = draw(st.integers(0, len(text)))
    end = draw(st.integers(start, min(len(text), start + 30)))
    return text[:start] + draw(st.text('0123456789.,- enaif\n"x', max_size=6)) + text[end:]
