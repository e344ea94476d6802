"""Optional packages: the extras of the installation, imported where they are used."""

import importlib
from types import ModuleType

from hyjax.util.errors import InputError


def optional_module(module: str, extra: str, where: str, *, besides: str = "") -> ModuleType:
    """An optional package's module.

    Args:
        besides: a command that is needed after that of the extra.

    Example:
        >>> optional_module("no_such_package", "tour", "tour")
        Traceback (most recent call last):
        hyjax.util.errors.InputError: tour: needs the package no_such_package; install it with: ...
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        missing = (error.name or module).partition(".")[0]
        also = f", then: {besides}" if besides else ""
        raise InputError(
            f"{where}: needs the package {missing}; install it with: pip install '.[{extra}]'{also}"
        ) from None
