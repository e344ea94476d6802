"""Names of rooms of known truth, checked without making one."""

from hyjax.util.errors import InputError, did_you_mean

ROOM_PREFIX = "room:"
"""Beginning of the name of a scene that is a room of known truth."""
EXAMPLE_ROOMS = ("builtin-0", "random-5-6-day", "random-11-0-both", "random-23-6-lamps")
"""Examples: those that `experiments.truth` chooses on."""


def check_room(name: str) -> str:
    """Name of a room of known truth, or `InputError` if there is none of this name."""
    kind, *parts = name.split("-")
    numbers = parts[:2] if kind == "random" else parts
    form = (kind == "builtin" and len(parts) == 1) or (
        kind == "random" and len(parts) == 3 and parts[2] in ("day", "lamps", "both")
    )
    if not form or not all(part.isdigit() for part in numbers):
        raise InputError(
            f"rooms: no room {name!r}{did_you_mean(name, EXAMPLE_ROOMS)}; there are builtin-SEED and "
            f"random-SEED-NUMBER-day, -lamps or -both, such as {', '.join(EXAMPLE_ROOMS)}"
        )
    return name
