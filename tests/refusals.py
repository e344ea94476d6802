"""Checks that bad input is one clear line."""

from collections.abc import Callable
from pathlib import Path

import pytest

from hyjax.util.errors import InputError


def refuses(call: Callable[[], object], *parts: str) -> None:
    """The call fails with one line that holds all `parts`."""
    with pytest.raises(InputError) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message and all(part in message for part in parts), message


def refuses_capture(path: Path, *parts: str, strict: bool = False) -> None:
    """Opening a capture, or reading all of its frames, fails with one line that holds all `parts`."""
    from hyjax.data.registry import open_capture

    refuses(lambda: list(open_capture(path, strict=strict)), *parts)


def leaves_out_a_frame(path: Path, count: int, *parts: str) -> None:
    """One frame of a capture cannot be used, and `count` others can; a line holds all `parts`, and is strict's."""
    from hyjax.data.registry import open_capture

    assert len(open_capture(path)) == count
    refuses_capture(path, "1 frames cannot be used and are left out", *parts, strict=True)
