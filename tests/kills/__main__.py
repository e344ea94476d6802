"""Kills as a command: `python -m tests.kills COMMAND... --kills N --out FOLDER`.

A line of JSON for each command in `FOLDER/kills.jsonl`, and a table at the end.
"""

import argparse
import dataclasses
import json
from pathlib import Path

from .commands import COMMANDS
from .harness import Killer, Outcome


def main() -> None:
    """Kill the commands that are named, or all."""
    parser = argparse.ArgumentParser(prog="python -m tests.kills", description=__doc__)
    parser.add_argument("commands", nargs="*", metavar="COMMAND", help=", ".join(COMMANDS))
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--in-a-row", type=int, default=2, help="kills of one run before it is brought to its end")
    parser.add_argument("--out", type=Path, default=Path("results/kills"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--together", action="store_true", help="run each twice at the same time instead")
    parser.add_argument("--full", type=int, help="run each on so many full disks instead")
    options = parser.parse_args()
    if unknown := set(options.commands) - COMMANDS.keys():
        parser.error(f"no command {sorted(unknown)[0]!r}; there are {', '.join(COMMANDS)}")
    killer = Killer(options.out.resolve(), options.seed)
    outcomes = []
    for name in options.commands or COMMANDS:
        if options.together or options.full:
            command = COMMANDS[name]
            wrong = killer.fill(command, options.full) if options.full else killer.together(command)
            print(f"{name}: {len(wrong)} wrong", *wrong, sep="\n", flush=True)
            continue
        outcomes.append(killer.kill(COMMANDS[name], options.kills, in_a_row=options.in_a_row))
        with (options.out / "kills.jsonl").open("a") as file:
            file.write(json.dumps(dataclasses.asdict(outcomes[-1])) + "\n")
        print(*outcomes[-1].wrong, sep="\n", flush=True)
    if outcomes:
        print(table(outcomes))


def table(outcomes: list[Outcome]) -> str:
    """Outcomes as a table in Markdown."""
    header = ("command", "seconds undisturbed", "kills", "ended before", "runs compared", "wrong")
    rows = [header, ("---", *["---:"] * 5)]
    rows += [
        (o.command, f"{o.seconds:.0f}", str(o.kills), str(o.spared), str(o.finished), str(len(o.wrong)))
        for o in outcomes
    ]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


if __name__ == "__main__":
    main()
