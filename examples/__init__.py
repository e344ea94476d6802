"""Examples, numbered: each a program of its own that leaves a picture in out/examples."""
