"""Debian's Firefox, driven by WebDriver BiDi, which it speaks as it comes."""

import contextlib
import shutil
from collections.abc import Iterator
from typing import Any

import pytest
from extras import need


@contextlib.contextmanager
def launched_firefox(driver: Any, **preferences: Any) -> Iterator[Any]:
    """Browser of a driver of playwright's, without a screen.

    Args:
        preferences: by names with `_` in the place of dots.
    """
    need("playwright")
    from playwright.sync_api import Error

    path = shutil.which("firefox-esr") or shutil.which("firefox")
    assert path, "needs Firefox; apt install firefox-esr"
    values = {name.replace("_", "."): value for name, value in preferences.items()}
    launched = driver.firefox.launch(channel="moz-firefox", executable_path=path, firefox_user_prefs=values)
    try:
        try:
            launched.new_page().close()
        except Error as error:
            if "unknown command" not in str(error):
                raise
            pytest.skip(f"this playwright and this Firefox do not know each other's commands: {error.message}")
        yield launched
    finally:
        launched.close()
