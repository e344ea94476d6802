"""Geometry on the host (NumPy): cameras, meshes, ray casting, fusion of depth, the built-in room."""
