"""Sweeps: many tasks, keyed by their content, on worker processes that may die at any moment."""
