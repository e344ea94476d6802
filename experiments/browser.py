"""A real browser without a screen: Debian's chromium, driven by playwright."""

import contextlib
import shutil
from collections.abc import Iterator, Sequence
from typing import Any

from hyjax.util.errors import InputError

NAMES = ("chromium", "chromium-browser", "google-chrome")
ARGUMENTS = [
    "--no-sandbox",
    "--no-first-run",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
SOFTWARE_GPU = (
    "--disable-gpu-watchdog",
    "--enable-unsafe-webgpu",
    "--use-webgpu-adapter=swiftshader",
    "--enable-features=Vulkan",
    "--enable-dawn-features=disable_workgroup_init",
)
"""Options for WebGPU on the processor. Zeros in workgroups' memory, which each shader of ours fills first, would be
compiled for seconds a shader.
"""


@contextlib.contextmanager
def browser(options: Sequence[str] = ()) -> Iterator[Any]:
    """The browser.

    Args:
        options: of its command line, besides `ARGUMENTS`.

    Raises:
        InputError: playwright or chromium is not installed.
    """
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        raise InputError("browser: needs playwright; pip install playwright") from None
    chromium = next((path for name in NAMES if (path := shutil.which(name))), None)
    if chromium is None:
        raise InputError("browser: needs chromium; apt install chromium")
    with sync_playwright() as driver:
        launched = driver.chromium.launch(executable_path=chromium, args=[*ARGUMENTS, *options])
        try:
            yield launched
        finally:
            launched.close()
