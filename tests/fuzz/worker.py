"""The process that reads mutated files: `python -m tests.fuzz.worker`, which `runner` starts."""

import json
import logging
import shutil
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .cases import Bench, limit_memory
from .runner import SECONDS, Row

BYTES = 8 << 30
"""Memory after which the system refuses more, lest the machine stops; a case may take far less."""
TOLD = 500
"""Cases between two rows."""


def cases(name: str, start: int, task: dict[str, Any]) -> Iterator[Row]:
    """The cases of one reader: a row for some hundred of them."""
    folder, kept, seed = Path(task["folder"]), Path(task["kept"]), task["seed"]
    bench = Bench(name, folder / "bench")
    for file, content in bench.files.items():  # what is imported at the first call is not the case's
        bench.run(file, content)
    limit_memory(BYTES)
    begin = time.monotonic()
    counts: Counter[str] = Counter()
    others: list[Row] = []
    worst, most, done = 0.0, 0, start >= task["stop"]
    for number in range(start, task["stop"]):
        (folder / "beat").write_text(str(number))
        file, content = bench.case(number, seed)
        outcome = bench.run(file, content)
        late = outcome.seconds > SECONDS
        counts["other" if late else outcome.kind] += 1
        worst, most = max(worst, outcome.seconds), max(most, outcome.mib)
        if outcome.kind == "other" or late:
            kept.mkdir(parents=True, exist_ok=True)
            path = kept / f"{name.replace(' ', '_')}-{seed}-{number}-{Path(file).name}"
            path.write_bytes(content if isinstance(content, bytes) else content.encode())
            others.append({"case": number, "note": outcome.note or f"{outcome.seconds:.1f} s", "file": path.name})
        over = task["seconds"] is not None and time.monotonic() - begin > task["seconds"]
        done = over or number == task["stop"] - 1
        if done or counts.total() >= TOLD:
            yield {"counts": dict(counts), "worst_seconds": round(worst, 3), "worst_mib": most} | {
                "others": others,
                "done": done,
            }
            counts, others, worst, most = Counter(), [], 0.0, 0
        if over:
            break
    if start >= task["stop"]:
        yield {"counts": {}, "others": [], "done": True}
    shutil.rmtree(folder / "bench")


def main() -> None:
    """Run what the argument says, in JSON: see `runner.run`."""
    task = json.loads(sys.argv[1])
    logging.getLogger().addHandler(logging.NullHandler())
    for name, start in task["left"]:
        for row in cases(name, start, task):
            print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
