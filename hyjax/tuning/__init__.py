"""The best schedule, or the best configuration of a whole frame, for a time on a device."""
