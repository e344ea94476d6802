"""Temporal filter: refined light, and a network's features, carried along the surface from frame to frame."""

from hyjax.video.carried_guide import CarriedGuide
from hyjax.video.temporal_filter import Memory, Video, fill_depth, recall, remembers, steady

__all__ = ["CarriedGuide", "Memory", "Video", "fill_depth", "recall", "remembers", "steady"]
