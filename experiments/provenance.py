"""Command, date, commit, machine and load of a run, from its rows."""

import dataclasses
import importlib
import shlex
import sys
from collections.abc import Sequence
from typing import Any

from experiments.records import UNSETTLED_OPTIONS, Row, is_finished, machine


def provenance(rows: Sequence[Row]) -> str:
    """Command, date, commit, device and load of rows, in a sentence."""
    first = rows[0]
    if "source" in first:
        return f"{first['origin']} That commit has the experiment, which was removed since."
    commits = ", ".join(dict.fromkeys(short(row["commit"]) for row in rows))
    finished = "" if is_finished(list(rows)) else " Interrupted before its end."
    return f"`{command(first)}`; {first['date']}, commit {commits}; {machine(first)}; {load(rows)}.{finished}"


def short(commit: str) -> str:
    """Such as `0123456789` or `0123456789-dirty`, where files had changes that were not committed."""
    return commit[:10] + commit[40:]


def load(rows: Sequence[Row]) -> str:
    """Load of the machine, as far as it is known."""
    found = [row["load"] for row in rows if isinstance(row.get("load"), int | float)]
    return rows[0].get("load_told") or (f"load before it up to {max(found):.1f}" if found else "load not recorded")


def command(row: Row) -> str:
    """Command line that makes such rows: all settings that are not the default; an own experiment's is its file."""
    name = row["experiment"]
    try:
        config, parts = importlib.import_module(f"experiments.{name}").Config, [f"python -m experiments.{name}"]
    except ModuleNotFoundError as error:
        if error.name != f"experiments.{name}":
            raise
        config, parts = vars(sys.modules["__main__"]).get("Config"), [f"python {name}.py"]
    for field in dataclasses.fields(config) if config else ():
        value, usual = row["settings"].get(field.name), default_of(field)
        if field.name in UNSETTLED_OPTIONS or value is None or value == usual:
            continue
        option = field.name.replace("_", "-")
        if isinstance(value, bool):
            parts.append(f"--{option}" if value else f"--no-{option}")
        else:
            values = value if isinstance(value, list) else [value]
            parts += [f"--{option}", *(quoted(str(one)) for one in values)]
    return " ".join(parts)


def default_of(field: "dataclasses.Field[Any]") -> Any:
    """Default of an option, as a row has it."""
    default = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
    return list(default) if isinstance(default, tuple) else default


def quoted(text: str) -> str:
    """Text as a shell wants it, variables left alone."""
    return f'"{text}"' if shlex.quote(text.replace("$", "")) != text.replace("$", "") else text
