"""Captures on disk → `Frame`s. One file a format."""
