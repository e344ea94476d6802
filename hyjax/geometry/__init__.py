"""Geometry on the host (NumPy): cameras, meshes, ray casting, point clouds, fusion of depth."""
