"""Server of a folder with a page, such as an exported one: `hyjax serve`."""

import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from hyjax.util.errors import InputError
from hyjax.util.hosts import LOCAL, LOCAL_NAMES
from hyjax.util.interrupts import exit_now
from hyjax.util.settings import Settings

if TYPE_CHECKING:
    from hyjax.device.server import Server

INDEX = "index.html"


@dataclasses.dataclass(frozen=True)
class ServeSettings(Settings):
    """Show an exported page: its folder, to browsers of this machine or of the local network."""

    folder: tyro.conf.Positional[Path]
    """Folder of the page, as `hyjax export` writes it."""
    host: str = LOCAL
    """Address to listen at. Any but the default has HTTPS, as WebGPU needs it; everybody who reaches it sees the
    folder."""
    port: int = 8091
    """Port of the page; 0 for any free port."""

    @property
    def is_local(self) -> bool:
        """Whether only this machine can reach the page."""
        return self.host in LOCAL_NAMES


def open_folder(settings: ServeSettings) -> "Server":
    """Open a server of a folder."""
    from hyjax.device.server import FolderSite, Server

    folder = settings.folder
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    if not (folder / INDEX).is_file():
        raise InputError(f"{folder}: no {INDEX} in it; give the folder that hyjax export has written")
    if not 0 <= settings.port <= 65535:
        raise InputError(f"port: must lie in 0..65535, got {settings.port}")
    return Server(FolderSite(folder), settings.host, settings.port)


def run_serve(settings: ServeSettings) -> None:
    """`hyjax serve`."""
    import threading

    server = open_folder(settings)
    if not settings.is_local:
        print(f"hyjax: listening at {settings.host}: everybody who reaches it sees this folder", file=sys.stderr)
    print(server.invitation(), flush=True)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        server.stop()
        exit_now(0)
