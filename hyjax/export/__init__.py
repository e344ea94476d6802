"""Exports: a scene with its tuned cascade, written for where there is no Python."""
