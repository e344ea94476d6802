"""A graphics processor for the tests: any that wgpu finds, such as Mesa's software one."""

from typing import Any

import pytest
from extras import need

from hyjax.device.webgpu import open_device
from hyjax.util.errors import InputError


@pytest.fixture(scope="session")
def device() -> Any:
    need("device")
    try:
        return open_device()
    except InputError as error:
        pytest.skip(str(error))
