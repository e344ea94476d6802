"""Choices of how a frame is relit that cost time or quality: one table, one row a choice.

Configurations and their files, options of `hyjax relight`, the search space of `hyjax tune` and the bounds of its
gradients, its reports, and what other renderers say that they cannot follow, all read `table.CHOICES`. A new choice
is its row and the place that uses it; of the light on the surface the row has that place, too (`use`).
"""
