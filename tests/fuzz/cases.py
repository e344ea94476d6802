"""A case: one mutated file, read once; what came of it, how long it took, what was written to stderr."""

import contextlib
import os
import random
import resource
import shutil
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from hyjax.util.errors import InputError

from .bombs import bombs
from .mutations import CLASSICS, mutated
from .readers import READERS

SEED = 0
MOST_MIB = 2048
"""Memory that one case may take."""
ODD_FILES = ["/proc/self/mem", "/proc/self/maps", "/dev/zero", "/dev/full", "pipe", "folder", "itself", "nowhere"]
"""Places that a link takes the file's place for, and files that are none."""
FIRST_CASES = len(CLASSICS) + len(ODD_FILES)
"""Number of cases that are the same for each reader; after them come its bombs."""


class Outcome(NamedTuple):
    """What came of a case.

    Attributes:
        kind: "result", "InputError" or "other".
        seconds: of the processor that it took: the clock's depend on what else runs.
        mib: memory that it took.
        note: of another one, what it was.
    """

    kind: str
    seconds: float
    mib: int
    note: str = ""


class Bench:
    """A reader with its seeds, to be given mutated files.

    Args:
        name: of the reader.
        folder: an empty folder for the seeds and the mutated file; one in memory is fastest.

    Attributes:
        first_mutated: number of the first case that is drawn.
    """

    def __init__(self, name: str, folder: Path) -> None:
        self.name, self.reader, self._folder = name, READERS[name], folder / "case"
        seeds = folder / "seeds"
        seeds.mkdir(parents=True)
        self.reader.make(seeds)
        files = sorted(path for path in seeds.rglob("*") if path.is_file())
        self.files = {path.relative_to(seeds).as_posix(): path.read_bytes() for path in files}
        self._bombs = bombs(name)
        self.first_mutated = FIRST_CASES + len(self._bombs)
        shutil.copytree(seeds, self._folder)

    def case(self, number: int, seed: int = SEED) -> tuple[str, bytes | str]:
        """Name and content of the file of a case, or what lies in its place; the same for the same numbers."""
        source = random.Random(f"{self.name} {seed} {number}")
        names = list(self.files)
        if number < len(CLASSICS):
            return names[number % len(names)], CLASSICS[number]
        if FIRST_CASES <= number < self.first_mutated:
            end, content = self._bombs[number - FIRST_CASES]
            return next((name for name in names if name.endswith(end)), names[0]), content
        name = source.choice(names)
        if not self.reader.stream:
            if number < FIRST_CASES:
                return name, ODD_FILES[number - len(CLASSICS)]
            if source.random() < 0.01:
                return name, source.choice(ODD_FILES)
        return name, mutated(self.files[name], [self.files[other] for other in names], source)

    def run(self, name: str, content: bytes | str) -> Outcome:
        """Read a mutated file, or an odd one."""
        path = self._folder / name
        if isinstance(content, bytes):
            path.write_bytes(content)
        else:
            _put_odd_file(path, content)
        peak = Peak()
        with written_to_stderr() as noise, warnings.catch_warnings():
            warnings.simplefilter("always")
            begin = time.process_time()
            kind, note = "result", ""
            try:
                self.reader.read(self._folder if self.reader.whole else path)
            except InputError as error:
                kind = "InputError"
                if "\n" in str(error) or len(str(error)) > 700:
                    kind, note = "other", f"a message of {len(str(error))} characters or several lines"
            except BaseException as error:
                if isinstance(error, KeyboardInterrupt):
                    raise
                kind, note = "other", f"{type(error).__name__}: {str(error)[:300]} ({_place(error)})"
            seconds = time.process_time() - begin
        if (taken := peak.mib()) > MOST_MIB:
            kind, note = "other", f"took {taken} MiB"
        if noise and kind != "other":
            kind, note = "other", f"stderr: {noise[0][:300]}"
        self._restore(name)
        return Outcome(kind, seconds, taken, note)

    def _restore(self, name: str) -> None:
        """Undo the case, and what a reader has written beside it."""
        path = self._folder / name
        if path.is_symlink() or not path.is_file():
            path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink(missing_ok=True)
        path.write_bytes(self.files[name])
        if not self.reader.writes:
            return
        for path in self._folder.iterdir():
            if path.name not in self.files:
                path.unlink()
        for inside, content in self.files.items():
            (self._folder / inside).write_bytes(content)


def _put_odd_file(path: Path, kind: str) -> None:
    path.unlink()
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to(path if kind == "itself" else kind)


def _place(error: BaseException) -> str:
    """Where in the package an exception came from."""
    found, trace = "", error.__traceback__
    while trace is not None:
        file = trace.tb_frame.f_code.co_filename
        if "/hyjax/" in file or not found:
            found = f"{Path(file).name}:{trace.tb_lineno}"
        trace = trace.tb_next
    return found


@contextlib.contextmanager
def written_to_stderr() -> Iterator[list[str]]:
    """What the block writes to file descriptor 2, as libraries do: filled when it ends, empty if nothing."""
    found: list[str] = []
    with os.fdopen(os.memfd_create("stderr"), "r+b") as file:
        before = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield found
        finally:
            os.dup2(before, 2)
            os.close(before)
        if os.fstat(file.fileno()).st_size:
            file.seek(0)
            found.append(file.read(2000).decode(errors="replace"))


def limit_memory(most: int) -> None:
    """Let this process take so many bytes more than it has now; a case that wants more is a fault, not a result."""
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + most, resource.RLIM_INFINITY))


class Peak:
    """Most memory that this process has had since this was made."""

    def __init__(self) -> None:
        Path("/proc/self/clear_refs").write_text("5")
        self._before = self._highest()

    def mib(self) -> int:
        """More than there was at first."""
        return (self._highest() - self._before) >> 10

    def _highest(self) -> int:
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
