"""Tuning of the whole frame: which configuration makes the best picture within a frame's time."""
