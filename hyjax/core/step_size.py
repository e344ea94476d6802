"""Default step size of the diffusion, available before JAX is loaded."""

DEFAULT_LAM = 0.24
"""Step size λ of Metzger et al.; the paper gives none."""
