"""Step size of the diffusion, which is known before JAX is loaded."""

DEFAULT_LAM = 0.24
"""Metzger's λ; the paper names none."""
