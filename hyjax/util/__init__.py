"""Files, cache, clock, threads and other parts that every layer uses."""
