"""HTML from Python: whatever is not markup already is escaped, so that nothing can be forgotten."""

import html
from collections.abc import Iterable
from typing import Any

VOID = {"img", "meta"}


class Html(str):
    """Text that is markup already."""

    __slots__ = ()


def tag(name: str, /, *children: str | Iterable[str], **attributes: Any) -> Html:
    """An element. Children that are not `Html` are escaped, as attributes are; `class_` and `data_x` as usual."""
    text = "".join(
        f" {key.rstrip('_').replace('_', '-')}" + ("" if value is True else f'="{html.escape(str(value))}"')
        for key, value in attributes.items()
        if value is not None and value is not False
    )
    if name in VOID:
        return Html(f"<{name}{text}>")
    return Html(f"<{name}{text}>{join(children)}</{name}>")


def join(children: Iterable[str | Iterable[str]]) -> Html:
    """Pieces one after the other, escaped where they are not markup."""
    parts = []
    for child in children:
        if isinstance(child, str):
            parts.append(child if isinstance(child, Html) else html.escape(child))
        else:
            parts.append(join(child))
    return Html("".join(parts))
