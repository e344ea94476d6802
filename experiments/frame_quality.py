"""Quality that whole frames keep: with light at fewer pixels, and of large frames that are relit smaller."""

import time
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from experiments.blocks import Table
from experiments.records import Results, Row, of_kind
from experiments.truth_bench import TruthBench
from experiments.truth_camera import Exposed, fit_gains
from hyjax.configuration import Configuration
from hyjax.data.frames import spread
from hyjax.metrics import psnr
from hyjax.scene.relighter import Relighter

SETUPS = ("evening-lamps", "two-colors", "golden-hour", "night-moon")
PHOTOS = 12
SIZE, LARGE_SIZE = (320, 240), (1280, 960)
"""Width and height of frames by sampling, and of large ones."""
FRAMES, LARGE_FRAMES = 6, 2
"""Number of frames of each room and set-up."""


def add_samplings(results: Results, room: str, samplings: Sequence[int]) -> None:
    """Add the scores of a room's frames by sampling."""
    bench = TruthBench(room, PHOTOS, SIZE, 1.0)
    for setup in SETUPS:
        for index in spread(range(PHOTOS), FRAMES):
            truth = bench.capture.truth(bench.scene.lights(setup), [index])[0]
            for sampling in samplings:
                own = Configuration().with_choices({"sampling": sampling})
                image = np.asarray(bench.scene.relit(index, setup, own).image)
                scores = _scores(image, truth)
                results.add(kind="quality", room=room, setup=setup, index=index, sampling=sampling, **scores)


def add_large(results: Results, room: str) -> None:
    """Add the scores and times of a room's large frames, relit smaller, as they are, and as others are."""
    bench = TruthBench(room, PHOTOS, LARGE_SIZE, 1.0)
    for setup in SETUPS:
        ways = {whole: Relighter(bench.scene, setup, whole=whole) for whole in (False, True)}
        for index in spread(range(PHOTOS), LARGE_FRAMES):
            truth = bench.capture.truth(bench.scene.lights(setup), [index])[0]
            for whole, relighter in ways.items():
                np.asarray(relighter.picture(index))  # compiles
                cpu = time.process_time()
                image = np.asarray(relighter.picture(index))
                taken = {"cpu_ms": 1e3 * (time.process_time() - cpu), **_scores(image, truth)}
                results.add(kind="large", room=room, setup=setup, index=index, whole=whole, **taken)


def differences(rows: Sequence[Row]) -> dict[tuple[int, str], float]:
    """Mean difference in dB of each sampling above 1 to sampling 1, raw and fitted."""
    samplings = sorted({row["sampling"] for row in rows} - {1})
    return {
        (sampling, fit): float(np.mean(_pairs(rows, "sampling", sampling, 1, fit)))
        for sampling in samplings
        for fit in ("raw", "fitted")
    }


def tables(rows: Sequence[Row]) -> Iterator[Table]:
    """Tables of the rows that there are."""
    if quality := of_kind(rows, "quality"):
        rooms = len({row["room"] for row in quality})
        yield Table(
            f"PSNR against true pictures less that of sampling 1, dB: mean of {rooms} rooms under "
            f"{len(SETUPS)} set-ups.",
            ["sampling", "picture", "difference"],
            [[str(k), fit, f"{value:+.3f}"] for (k, fit), value in differences(quality).items()],
            names=2,
        )
    if large := of_kind(rows, "large"):
        found = {f"PSNR {fit}, dB": _pairs(large, "whole", False, True, fit) for fit in ("raw", "fitted")}
        found["processor time, ms"] = _pairs(large, "whole", False, True, "cpu_ms")
        (width, height), rooms = LARGE_SIZE, len({row["room"] for row in large})
        yield Table(
            f"Frames of {width} x {height} relit smaller than others by half, less those that are not, which take "
            f"{np.median([row['cpu_ms'] for row in large if row['whole']]):.0f} ms: {len(large) // 2} pictures of "
            f"{rooms} rooms under {len(SETUPS)} set-ups.",
            ["", "median", "least", "most"],
            [[name, *(f"{f(d):+.3g}" for f in (np.median, np.min, np.max))] for name, d in found.items()],
        )


def _scores(image: Float[np.ndarray, "h w 3"], truth: Float[np.ndarray, "h w 3"]) -> dict[str, float]:
    exposed = Exposed(image)
    fitted = exposed.display(fit_gains(exposed, truth))
    return {"raw": float(psnr(exposed.display(), truth)), "fitted": float(psnr(fitted, truth))}


def _pairs(rows: Sequence[Row], key: str, value: object, base: object, score: str) -> Float[np.ndarray, "n"]:
    """Differences of a score between pictures with one value of `key` and those with the other."""
    scores = {(row["room"], row["setup"], row["index"], row[key]): row[score] for row in rows}
    pictures = [picture for *picture, own in scores if own == value and (*picture, base) in scores]
    return np.array([scores[*picture, value] - scores[*picture, base] for picture in pictures])
