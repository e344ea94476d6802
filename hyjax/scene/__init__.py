"""A capture with its surface and lights, ready to be relit."""
