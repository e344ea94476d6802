"""What the package is tested against: the paper written out literally, and numerical differentiation."""
