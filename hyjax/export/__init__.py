"""The repaired filter and the guide network for other runtimes: one file a target, checked where it was made."""
