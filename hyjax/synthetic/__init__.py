"""Generated rooms with known surface and light: the built-in room and random rooms."""
