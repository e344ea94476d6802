"""Temporal filter: refined light carried along the surface from frame to frame."""

from hyjax.video.temporal_filter import Memory, Video, fill_depth, recall, remembers, steady

__all__ = ["Memory", "Video", "fill_depth", "recall", "remembers", "steady"]
