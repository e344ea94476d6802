"""Exports for where there is no Python: a page of a scene, or one function for another runtime."""
