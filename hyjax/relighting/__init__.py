"""Relighting of a capture from end to end: what `hyjax relight` does."""
