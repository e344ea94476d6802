"""Measuring and, later, tuning."""
