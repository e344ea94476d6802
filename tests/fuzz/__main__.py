"""Command line: `python -m tests.fuzz --cases 10000`, `--minutes 30`, `--reader png`.

Prints a table, and writes a row for each reader to `rows.jsonl` in the folder `--out`, with the files of all cases
that gave neither a result nor an `InputError`. The status is 1 if there was one.
"""

import argparse
import json
from pathlib import Path

from .readers import READERS
from .runner import run


def main() -> int:
    """Run the fuzzer."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, help="of each reader (300 without --minutes)")
    parser.add_argument("--minutes", type=float, help="for all readers together")
    parser.add_argument("--reader", action="append", choices=READERS, help="only this one; may be given again")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--out", type=Path, default=Path("fuzz-out"))
    options = parser.parse_args()
    names = options.reader or list(READERS)
    count = options.cases or (10**9 if options.minutes else 300)
    seconds = options.minutes * 60 / len(names) if options.minutes else None
    options.out.mkdir(parents=True, exist_ok=True)
    print(f"| {'reader':18} |  cases | results | InputErrors | others | worst s | worst MiB |")
    print("| :--- | ---: | ---: | ---: | ---: | ---: | ---: |")
    bad = 0
    with (options.out / "rows.jsonl").open("a") as file:
        cases = range(options.first, options.first + count)
        for row in run(names, cases, options.seed, options.out / "kept", seconds):
            print(
                f"| {row['reader']:18} | {row['cases']:6} | {row['result']:7} | {row['InputError']:11} | "
                f"{row['other']:6} | {row['worst_seconds']:7.2f} | {row['worst_mib']:9} |",
                flush=True,
            )
            for other in row["others"]:
                print(f"    case {other['case']}: {other['note']}", flush=True)
            file.write(json.dumps(row) + "\n")
            file.flush()
            bad += row["other"]
    return 1 if bad else 0


if __name__ == "__main__":
    raise SystemExit(main())
