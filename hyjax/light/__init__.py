"""Lights, shading, shadow maps and colour, as pure functions on arrays."""
