"""Tables of the documentation: which kept rows, and which of their experiment's tables, a name stands for."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class Published:
    """A table on a page.

    Attributes:
        rows: name of the file in `evidence/`.
        number: which of the tables that the experiment makes of these rows, from 0.
        columns: which columns besides the names; all if empty.
        lines: which lines, by their first cell; all if empty.
        caption: instead of the experiment's own.
    """

    rows: str
    number: int = 0
    columns: tuple[str, ...] = ()
    lines: tuple[str, ...] = ()
    caption: str = ""


TRUTH_COLUMNS = ("raw PSNR dB", "raw LPIPS", "fitted PSNR dB", "fitted LPIPS", "Δ fitted dB")
TRUTH_LINES = (
    "untouched photo",
    "paper's method",
    "OpenCV's global smoother",
    "hyjax 0.1",
    "0.1 / E_old",
    "0.1 / E_old + bounces",
    "**hyjax, all together**",
    "all, sources not told",
    "all, true E_old and bounces",
    "true mesh, E_old and light",
)
TRUTH_CAPTION = (
    "Rooms that no setting was chosen with: 32 pictures of four rooms under four set-ups of lights. *Δ*: mean "
    "difference to hyjax 0.1, which leaves the photo's light in, with its 95 % interval over rooms and set-ups. "
    "*E_old*: the photo's light."
)

LIGHT = ("paper's method, times light", "ours, times light")
FILTERS = ("strength / reach", "PSNR dB", "loss")

REAL_LINES = (
    "untouched photo",
    "three gains",
    "exp(polynomial 4)",
    "exp(polynomial 7)",
    "paper's method",
    "hyjax 0.1",
    "default without light edges",
    "**default**",
    "hyjax 0.1 + glow",
    "default + glow",
    "true ratio, blurred 8 px",
    "true ratio, blurred 4 px",
)
"""Not the oracle, whose fit had not converged when these rows were made."""

BEST_LINES = (
    "exp(polynomial 4)",
    "exp(polynomial 7), best 15 terms",
    "hyjax 0.1",
    "**default**",
    "hyjax 0.1, best 15 lights",
    "default, best 15 lights",
)

KITCHEN_PEERS = (
    "Repair of two lights at 512 x 512, judged on held-out frames of the kitchen: a simulated scan, seed 0, "
    "against a fusion of 150 depth maps with voxels of 0.02 m, up to 4 m; strengths chosen on {}. *: at an end of "
    "what was tried."
)

BEST_CAPTION = "true geometry, on blocks that nothing was fitted on. Piano: chosen on."

TABLES: dict[str, Published] = {
    # against the truth, and the photo's light
    "truth-short": Published("truth", 0, TRUTH_COLUMNS, TRUTH_LINES, TRUTH_CAPTION),
    "truth": Published("truth", 0),
    "truth-setups": Published("truth", 1),
    "truth-rooms": Published("truth", 2),
    "found-sources": Published("found_sources"),
    # real places under two lights
    "real": Published("real_geometries", 0, lines=REAL_LINES),
    "real-rough": Published("real_geometries", 1, lines=REAL_LINES),
    "real-scores": Published("real", 1, lines=REAL_LINES),
    "real-light": Published("real_geometries", 4),
    "real-best": Published("real_geometries", 0, lines=BEST_LINES, caption=f"PSNR dB, {BEST_CAPTION}"),
    "real-best-scores": Published("real", 1, lines=BEST_LINES, caption=f"SSIM / LPIPS / SIE / LFE, {BEST_CAPTION}"),
    "dark-frames": Published("dark_frames"),
    "patches": Published("patches"),
    # the paper's tables
    "directions-room": Published("paper_room", 0),
    "directions-kitchen": Published("paper_kitchen", 0),
    "correction-room": Published("paper_room", 1),
    "correction-kitchen": Published("paper_kitchen", 1),
    "consistency-room": Published("paper_room", 3),
    "consistency-kitchen": Published("paper_kitchen", 3),
    "fidelity-room": Published("paper_room", 5),
    "fidelity-kitchen": Published("paper_kitchen", 5),
    "fidelity-regions-room": Published("paper_room", 6),
    "fidelity-regions-kitchen": Published("paper_kitchen", 6),
    "reference-quality": Published("reference_quality"),
    "kappa-room": Published("kappa_room"),
    "kappa-kitchen": Published("kappa_kitchen"),
    "ablation-cascade-room": Published("paper_room", 7),
    "ablation-cascade-kitchen": Published("paper_kitchen", 7),
    "ablation-shadow-room": Published("paper_room", 9),
    "ablation-shadow-rough-room": Published("paper_room", 8),
    "ablation-shadow-kitchen": Published("paper_kitchen", 9),
    "ablation-shadow-rough-kitchen": Published("paper_kitchen", 8),
    # from frame to frame
    "flicker-room": Published("flicker_room"),
    "flicker-kitchen": Published("flicker_kitchen"),
    # frames a second
    "frame-rate": Published("frame_rate", 0),
    "frame-rate-stages": Published("frame_rate", 1),
    "frame-rate-one-core": Published("frame_rate_one_core", 0),
    "frame-rate-sizes": Published("frame_rate_sizes", 2),
    "frame-rate-own": Published(
        "frame_rate_sizes",
        2,
        ("frames/s", "CPU ms a frame"),
        caption="Frames of the built-in room, two cores of a virtual machine.",
    ),
    "frame-rate-large": Published("frame_rate_large", 3),
    "frame-rate-long": Published("frame_rate_long", 3),
    "frame-rate-sampling": Published("frame_rate_sampling", 3),
    "stage-times": Published("stage_times", 0),
    "first-picture": Published("first_picture", 0),
    "first-picture-stages": Published("first_picture", 1),
    "explore-latency": Published("explore_latency"),
    # tuning
    "presets": Published("frame_tuning", 0),
    "choices": Published("frame_tuning", 2),
    "number-search": Published("number_search", 0),
    "number-weights": Published("number_search", 1),
    "space-race": Published("space_race", 0),
    "frame-rate-default": Published("frame_rate_default", 0),
    "frame-rate-balanced": Published("frame_rate_balanced", 0),
    "frame-rate-fast": Published("frame_rate_fast", 0),
    # the learned guide
    "conductances": Published("conductances_kitchen"),
    "depth-middlebury": Published("depth_sr", 0),
    "depth-mosd": Published("depth_sr", 1),
    "depth-kitchen": Published("depth_sr", 2),
    "dada-mosd": Published("depth_sr_dada", 0),
    "dada-kitchen": Published("depth_sr_dada", 1),
    "guide-worth-room": Published("guide_worth_room"),
    "guide-worth-kitchen": Published("guide_worth_kitchen"),
    "guide-speed-16": Published("guide_speed_16"),
    "guide-speed-64": Published("guide_speed_64"),
    # live, tour, sweeps
    "live": Published("live", 0),
    "live-parts": Published("live", 1),
    "live-chair": Published("live", 3),
    "tour-changes": Published("tour_changes", 0),
    "tour-load": Published("tour_visits", 1),
    "fusion-chair": Published("fusion_borders_chair", 0),
    "fusion-room": Published("fusion_borders_room", 0),
    "sweep": Published("sweep_overhead"),
    "sweep-kills": Published("sweep_kills"),
    "install": Published("install_size"),
    "peers-gpu-steps": Published("peers_gpu", 0, caption="Steps on a GPU; the C loop on 16 processors beside it."),
    "peers-gpu": Published("peers_gpu", 1, caption="Cascades of 512 x 512, 3 channels, on a GPU."),
    # what does not carry over
    "fidelity-short": Published("paper_kitchen", 5, ("LPIPS", "PSNR dB"), LIGHT),
    "peers-room": Published("peers_room", 0, FILTERS),
    "peers-room-by-kitchen": Published("peers_room_by_kitchen", 0, FILTERS),
    "peers-kitchen": Published("peers_kitchen", 0, FILTERS, caption=KITCHEN_PEERS.format("its earlier frames")),
    "peers-kitchen-by-room": Published("peers_kitchen_by_room", 0, FILTERS, caption=KITCHEN_PEERS.format("room")),
}
"""Name on a page → table."""
