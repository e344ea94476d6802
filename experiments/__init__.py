"""One file an experiment. Each file's docstring gives its command, how long it takes and what to expect."""

EXPERIMENTS = (
    "paper_table",
    "truth",
    "real",
    "dark_frames",
    "readme_picture",
    "flicker",
    "ablation_cascade",
    "ablation_shadow",
    "structure",
    "conductances",
    "depth_sr",
    "guide_worth",
    "frame_tuning",
    "stage_times",
    "frame_rate",
    "first_picture",
    "fusion_borders",
    "bench_peers",
    "live",
)
"""Modules of experiments, in the report's order."""
