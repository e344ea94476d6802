"""Temporal reprojection of refined light, and of a network's features, along the surface between frames."""

from hyjax.video.carried_guide import CarriedGuide
from hyjax.video.temporal_filter import Memory, Video, fill_depth, recall, remembers, steady

__all__ = ["CarriedGuide", "Memory", "Video", "fill_depth", "recall", "remembers", "steady"]
