"""Training of the guide network by guided super-resolution."""
