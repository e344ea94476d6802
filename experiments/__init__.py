"""Experiments, one a file, whose docstring gives the command, its duration and the expected results."""

EXPERIMENTS = (
    "paper",
    "truth",
    "real",
    "dark_frames",
    "patches",
    "readme_picture",
    "flicker",
    "structure",
    "conductances",
    "depth_sr",
    "guide_worth",
    "light_edges",
    "frame_tuning",
    "number_search",
    "space_race",
    "stage_times",
    "frame_rate",
    "first_picture",
    "explore_latency",
    "fusion_borders",
    "bench_peers",
    "live",
    "tour_visits",
    "sweep_overhead",
)
"""Modules of experiments, in the report's order."""
