"""Relighting of a capture from end to end, the work of `hyjax relight`."""
