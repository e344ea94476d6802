"""Names of rooms of known truth, checked without making one."""

import re

from hyjax.util.errors import InputError, did_you_mean

ROOM_PREFIX = "room:"
"""Beginning of the name of a scene that is a room of known truth."""
EXAMPLE_ROOMS = ("builtin-0", "random-5-6-day", "random-11-0-both", "random-23-6-lamps")
"""Examples: those that `experiments.truth` chooses on."""


def check_room(name: str) -> str:
    """Name of a room of known truth, or `InputError` if there is none of this name."""
    if not re.fullmatch(r"builtin-\d+|random-\d+-\d+-(day|lamps|both)", name):
        raise InputError(
            f"rooms: no room {name!r}{did_you_mean(name, EXAMPLE_ROOMS)}; there are builtin-SEED and "
            f"random-SEED-NUMBER-day, -lamps or -both, such as {', '.join(EXAMPLE_ROOMS)}"
        )
    return name
