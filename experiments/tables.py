"""Tables of the documentation, written from kept rows by the functions that the experiments' own reports use.

    python -m experiments.tables            # write them anew
    python -m experiments.tables --check    # name those whose text and rows differ
    python -m experiments.tables --keep results/truth/rows.jsonl --name truth

A page has a table between `<!-- table: NAME -->` and `<!-- end -->`; `experiments.published` says which rows and
which of an experiment's tables a name stands for. Rows are kept in `evidence/`, a file for each run: its first line
has what all its rows share (experiment, settings, commit, date, device, versions), the others what each has
besides (`experiments.packing`). Numbers are rounded to five digits. `--keep` puts a finished run's rows there.

A file whose first line says `"source": "removed"` holds the cells of a table whose experiment has been removed. Its
text says so.

Takes seconds.
"""

import dataclasses
import datetime
import functools
import importlib
import json
import os
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.blocks import Table, markdown
from experiments.command import Experiment, run
from experiments.packing import packed, unpacked
from experiments.provenance import provenance
from experiments.published import TABLES, Published
from experiments.records import ROOT, Row, read_rows
from hyjax.util.errors import InputError
from hyjax.util.files import write_text

KEPT_FOLDER = ROOT / "evidence"
TABLE_BLOCK = re.compile(r"(?<=<!-- table: )([\w-]+)( -->\n)(.*?)(?=<!-- end -->)", re.DOTALL)
"""Name, and the text of a table."""
DIGITS = 5
SHARED_FIELDS = ("experiment", "settings", "commit", "date", "device", "cpu_count", "versions", "seed")


@dataclasses.dataclass(frozen=True)
class Config:
    check: bool = False
    """Write nothing; end with status 1 if a table's text differs from its rows."""
    keep: Path | None = None
    """Rows of a finished run, to be kept."""
    name: str | None = None
    """Of the kept file. Default: the experiment."""
    drop: tuple[str, ...] = ()
    """Kinds of rows that no table needs, to be left out of the kept file."""
    load: str | None = None
    """Other load of the machine meanwhile, in words, where the run has not recorded it."""


def main(config: Config) -> None:
    """Write or check all tables, or keep a run's rows.

    Raises:
        InputError: a page has a table that there is not, or rows cannot be read.
    """
    if config.keep is not None:
        print(f"kept as {keep(config.keep, config.name, config.load, config.drop)}")
        return
    texts = {name: text_of(published) for name, published in TABLES.items()}
    wrong = [f"{page.relative_to(ROOT)}: {what}" for page in pages() for what in update(page, texts, config.check)]
    used = {name for page in pages() for name, *_ in TABLE_BLOCK.findall(page.read_text(encoding="utf-8"))}
    wrong += [f"{name}: is on no page" for name in texts if name not in used]
    if not config.check:
        print(f"{len(used)} tables")
    elif wrong:
        print("\n".join([*wrong, "write them anew with python -m experiments.tables"]), file=sys.stderr)
        sys.exit(1)


def pages() -> list[Path]:
    """Pages that may have tables."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def update(page: Path, texts: Mapping[str, str], check: bool) -> list[str]:
    """Tables of a page whose text differs from `texts`; unless `check` the page is written with the right ones.

    Raises:
        InputError: a table that is not among `texts`.
    """
    before, stale = page.read_text(encoding="utf-8"), []

    def replaced(match: re.Match[str]) -> str:
        name, middle, text = match.groups()
        if name not in texts:
            raise InputError(f"{page}: no table {name!r}; experiments/published.py has the names")
        if text != texts[name]:
            stale.append(f"table {name} is not what its rows say")
        return name + middle + texts[name]

    after = TABLE_BLOCK.sub(replaced, before)
    if stale and not check:
        write_text(page, after)
    return stale


def text_of(published: Published) -> str:
    """Caption, table and where it comes from, in Markdown.

    Raises:
        InputError: no such rows, or no such table, columns or lines.
    """
    rows, tables = kept_run(published.rows)
    return "\n" + markdown([selected(tables, published), provenance(rows)]) + "\n\n"


@functools.cache
def kept_run(name: str) -> tuple[list[Row], list[Table]]:
    """Kept rows, and all tables that their experiment makes of them.

    Raises:
        InputError: no such rows.
    """
    rows = kept_rows(KEPT_FOLDER / f"{name}.jsonl")
    return rows, tables_of(rows)


def tables_of(rows: Sequence[Row]) -> list[Table]:
    """All tables that the rows' experiment makes of them, or the one that is kept as it was."""
    if "source" in rows[0]:
        first = rows[0]
        return [Table(first["caption"], first["header"], [row["cells"] for row in rows], first["names"])]
    return [block for block in experiment_of(rows).blocks(rows, KEPT_FOLDER) if isinstance(block, Table)]


def experiment_of(rows: Sequence[Row]) -> Experiment:
    """The experiment that has made rows."""
    module: Any = importlib.import_module(f"experiments.{rows[0]['experiment']}")
    found: Experiment = module.main
    return found


def selected(tables: Sequence[Table], published: Published) -> Table:
    """The table that is asked for, with the columns and lines that are."""
    if published.number >= len(tables):
        raise InputError(f"{published.rows}: makes {len(tables)} tables; number {published.number} is asked for")
    table = tables[published.number]
    missing = [column for column in published.columns if column not in table.header]
    missing += [line for line in published.lines if line not in (row[0] for row in table.rows)]
    if missing:
        raise InputError(f"{published.rows}: its table has no {missing[0]!r}; it has {', '.join(table.header)}")
    header = list(table.header)
    if twice := [column for column in published.columns if header.count(column) > 1]:
        raise InputError(f"{published.rows}: its table has {twice[0]!r} twice, so it cannot be chosen by its name")
    chosen = [*range(table.names), *map(header.index, published.columns)]
    places = chosen if published.columns else range(len(header))
    lines = [row for row in table.rows if not published.lines or row[0] in published.lines]
    rows = [[row[i] for i in places] for row in lines]
    return Table(published.caption or table.caption, [header[i] for i in places], rows, table.names)


def keep(path: Path, name: str | None = None, told: str | None = None, drop: Sequence[str] = ()) -> Path:
    """Put a run's rows among those kept, but for kinds to `drop`.

    Paths in the folder `$HYJAX_DATA` become relative to it. Rows that have no date yet get that of their file.

    Raises:
        InputError: the rows cannot be read, or there is none.
    """
    rows = [row for row in read_rows(path) if row.get("kind") not in drop]
    if not rows:
        raise InputError(f"{path}: has no rows")
    written = datetime.date.fromtimestamp(path.stat().st_mtime).isoformat()
    shared = {"date": written} | {key: rows[0][key] for key in SHARED_FIELDS if key in rows[0]}
    shared |= {"load_told": told} if told else {}
    own = [{key: row[key] for key in row if key not in shared or shared[key] != row[key]} for row in rows]
    lines = [rounded(shared), *packed([rounded(row) for row in own])]
    text = "".join(json.dumps(line, ensure_ascii=False, separators=(",", ":")) + "\n" for line in lines)
    KEPT_FOLDER.mkdir(exist_ok=True)
    out = KEPT_FOLDER / f"{name or rows[0]['experiment']}.jsonl"
    folder = os.environ.get("HYJAX_DATA")
    write_text(out, text.replace(folder, "$HYJAX_DATA") if folder else text)
    return out


def kept_rows(path: Path) -> list[Row]:
    """Rows of a kept file, each with the entries that all share.

    Raises:
        InputError: no such file, or it holds no rows.
    """
    try:
        shared, *rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: no kept rows ({error}); keep a run's with --keep") from None
    return [shared | row for row in unpacked(rows)]


def rounded(value: Any) -> Any:
    """Numbers to `DIGITS` digits."""
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [rounded(item) for item in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


if __name__ == "__main__":
    run(main)
