"""Commands that are killed at random moments, resumed, and compared with runs that nobody disturbed."""
