"""Addresses of the laser scans of an ARKitScenes scan's venue; `experiments.laser_scans` reads them.

Source: the data pages of ARKitScenes' repository.
"""

import csv
import io
from pathlib import Path

from hyjax.util.errors import InputError
from hyjax.util.reading import read_bytes

SPLITS = ("raw_train_val_splits.csv", "metadata.csv")
"""Tables of video and visit: the repository's, and the downloader's in the scans' folder."""
LASER = "laser_scanner_point_clouds"


def laser_folder(scan: Path, video: str) -> Path | None:
    """The laser scans of the venue: in the scan's own folder, or where the downloader puts them."""
    if any((scan / LASER).glob("*.ply")):
        return scan / LASER
    above = list(scan.parents)[:4]
    visits = (_visit(folder / name, video) for folder in above for name in SPLITS)
    visit = next(filter(None, visits), None)
    folders = (folder / LASER / visit for folder in above if visit is not None)
    return next((folder for folder in folders if folder.is_dir()), None)


def _visit(table: Path, video: str) -> str | None:
    """The visit in which a video was made, from a table with columns video_id and visit_id."""
    if not table.is_file():
        return None
    text = read_bytes(table).decode("utf-8", errors="replace")
    try:
        rows = [row for row in csv.DictReader(io.StringIO(text)) if row.get("video_id") == video]
    except csv.Error as error:
        raise InputError(f"{table}: not a table ({error})") from None
    visit = (rows[0].get("visit_id") or "") if rows else ""
    return visit.removesuffix(".0") or None  # pandas writes a column with gaps as floats
