"""Where hyjax keeps what it can compute again."""

import os
from pathlib import Path

import platformdirs


def cache_folder() -> Path:
    """The folder for rebuildable files: `$HYJAX_CACHE` if set, else the user's cache folder. Not created here."""
    override = os.environ.get("HYJAX_CACHE")
    return Path(override) if override else platformdirs.user_cache_path("hyjax")
