"""What a guide is worth: κ from the tuning frames alone, gains frame by frame."""

from experiments.guide_worth import best, blocks


def rows() -> list[dict]:
    """Two tuning and two held-out frames; on the held-out ones another κ would be better for the guide `b`."""
    scores = {
        ("rgb", 0.01): (20.0, 22.0, 30.0, 32.0),
        ("rgb", 0.02): (19.0, 22.0, 30.0, 32.0),
        ("b", 0.01): (20.0, 23.0, 31.0, 35.0),
        ("b", 0.02): (20.0, 22.0, 40.0, 40.0),
    }
    settings = {"schedule": "paper-80"}
    found = []
    for (guide, kappa), values in scores.items():
        for frame, psnr in enumerate(values):
            split = "tuning" if frame < 2 else "held-out"
            if split == "tuning" or kappa == 0.01:
                for method in ("paper's method", "ours"):
                    row = {"capture": "c", "method": method, "guide": guide, "kappa": kappa, "settings": settings}
                    found.append(row | {"kind": "score", "split": split, "frame": str(frame), "psnr": psnr})
    return found


def test_kappa_is_chosen_on_tuning_frames() -> None:
    assert best(rows(), "ours", "b") == best(rows(), "ours", "rgb") == 0.01


def test_the_table_has_gains_over_rgb_of_the_same_frames(tmp_path) -> None:  # type: ignore[no-untyped-def]
    table = blocks(rows(), tmp_path)[0]
    lines = {line[0]: line for line in table.rows}
    assert lines["ours, b"][1:3] == ["0.01", "21.50"]
    assert lines["ours, b"][3].startswith("33.00") and lines["ours, b"][4].startswith("2.00")
    assert lines["ours, rgb"][4].startswith("0.00")
    assert "2 tuning frames" in table.caption and "2 held-out ones" in table.caption
