"""One file an experiment. Each file's docstring gives its command, how long it takes and what to expect."""

EXPERIMENTS = (
    "paper_table",
    "paper_difference",
    "beyond",
    "flicker",
    "ablation_cascade",
    "ablation_shadow",
    "structure",
    "conductances",
    "depth_sr",
    "train_through",
    "reference_quality",
    "kinect_registration",
    "kappa_sweep",
    "guide_worth",
    "tuning_gain",
    "tuning_transfer",
    "tuning_promise",
    "tuning_optimum",
    "tuning_race",
    "stage_times",
    "guide_speed",
    "fusion",
    "bench_peers",
    "tour_latency",
)
"""Modules of experiments, in the report's order."""
