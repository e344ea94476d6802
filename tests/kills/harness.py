"""Runs in processes of their own, killed with all that they started."""

import dataclasses
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from hyjax.data.trees import open_tree
from hyjax.data.video_frames import VideoFrames
from hyjax.util.errors import InputError
from hyjax.util.files import PART_SUFFIX
from hyjax.util.images import read_image
from hyjax.util.reading import read_json

from .commands import CAPTURE, Command, differences, entries, prepare

LONGEST = 900.0
"""Seconds of one run."""
ROOT = Path(__file__).parents[2]


@dataclasses.dataclass
class Outcome:
    """What came of the kills of one command.

    Attributes:
        command: its name.
        seconds: of an undisturbed run.
        kills: runs that were killed.
        spared: runs that ended before.
        finished: runs that were brought to their end and compared.
        wrong: what differed, was cut off, left over or refused; one text each.
    """

    command: str
    seconds: float = 0.0
    kills: int = 0
    spared: int = 0
    finished: int = 0
    wrong: list[str] = dataclasses.field(default_factory=list)


class Killer:
    """Kills of commands, in a folder of their own.

    Args:
        folder: for the runs; the undisturbed ones and the capture are kept in it.
        seed: of the moments.
    """

    def __init__(self, folder: Path, seed: int = 0) -> None:
        self.folder, self._random = folder, random.Random(seed)
        (folder / "tmp").mkdir(parents=True, exist_ok=True)
        arguments = prepare(folder)
        if not (folder / CAPTURE).exists():
            self.run(arguments)

    def run(
        self,
        arguments: list[str],
        *,
        kill_after: float | None = None,
        largest: int = resource.RLIM_INFINITY,
    ) -> tuple[int, str]:
        """Run `python -m ...`; its status (-9 if it was killed) and what it said on stderr."""
        environment = os.environ | {"PYTHONPATH": str(ROOT), "TMPDIR": str(self.folder / "tmp")}
        process = subprocess.Popen(
            [sys.executable, "-m", *arguments],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,  # which no limit of a file's size cuts off
            start_new_session=True,
            env=environment,
            cwd=self.folder,
            text=True,
            errors="replace",
        )
        if largest != resource.RLIM_INFINITY:  # before it has loaded anything
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (largest, largest))
        try:
            _, said = process.communicate(timeout=LONGEST if kill_after is None else kill_after)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            _, said = process.communicate()
            if kill_after is None:
                return -1, f"took more than {LONGEST:.0f} s"
        return process.returncode, said

    def undisturbed(self, command: Command) -> tuple[Path, float]:
        """Folder and seconds of a run that nobody disturbs: the second one, when everything is compiled."""
        seconds = 0.0
        for number in range(2):
            out = self.folder / command.name / f"undisturbed-{number}"
            if not out.exists():
                begun = time.monotonic()
                status, said = self.run(command.arguments(self.folder, out))
                seconds = time.monotonic() - begun
                if status:
                    raise RuntimeError(f"{command.name} fails by itself: {said[-2000:]}")
                (out.parent / "seconds.txt").write_text(str(seconds))
        return out, float((out.parent / "seconds.txt").read_text())

    def kill(self, command: Command, kills: int, *, in_a_row: int = 2) -> Outcome:
        """Kill a command so many times, bring the runs to their end, and compare them.

        Args:
            command: which.
            kills: how many times.
            in_a_row: of them on one run, which goes on in between.
        """
        model, seconds = self.undisturbed(command)
        outcome, number = Outcome(command.name, seconds), 0
        expected = command.result(model)
        while outcome.kills < kills and number < 3 * kills:
            out = self.folder / command.name / f"killed-{number}"
            number += 1
            for _ in range(min(in_a_row, kills - outcome.kills)):
                status, said = self._go_on(command, out, self._random.uniform(0.0, seconds))
                outcome.spared += status == 0
                outcome.kills += status == -signal.SIGKILL
                outcome.wrong += [f"{out.name}: {text}" for text in damages(out)]
                if status not in (0, -signal.SIGKILL):
                    outcome.wrong.append(f"{out.name}: status {status}, {said.strip()[-300:]}")
            status, said = self._go_on(command, out, None)
            outcome.finished += 1
            if status or "Traceback" in said:
                outcome.wrong.append(f"{out.name}: at last status {status}, {said.strip()[-300:]}")
                continue
            wrong = differences(command.result(out), expected) + damages(out) + leftovers(out)
            if command.name == "tune":
                one, other = entries(out), entries(model)
                wrong += [f"entry {key}" for key in one.keys() & other.keys() if one[key] != other[key]]
            outcome.wrong += [f"{out.name}: {text}" for text in wrong]
            if not wrong:
                shutil.rmtree(out)
        return outcome

    def together(self, command: Command, apart: float = 0.5) -> list[str]:
        """Run a command twice at the same time into one folder; what is wrong with what they come to.

        One may be refused with a line, if the other then does all.
        """
        model, _ = self.undisturbed(command)
        out = self.folder / command.name / "together"
        shutil.rmtree(out, ignore_errors=True)
        with ThreadPoolExecutor() as pool:
            runs = []
            for _ in range(2):
                runs.append(pool.submit(self.run, command.arguments(self.folder, out)))
                time.sleep(apart)
            ended = [run.result() for run in runs]
        wrong = [f"status {status}: {said[-500:]}" for status, said in ended if status not in (0, 2)]
        for status, said in ended:
            lines = said.replace("\r", "\n").split("\n")  # with those of progress bars
            if status == 2 and ("Traceback" in said or sum(": /" in line for line in lines) != 1):
                wrong.append(f"refused with something else than a line: {said[-500:]}")
        if all(status for status, _ in ended):  # there is nothing to compare
            return [*wrong, "neither came to its end"]
        return wrong + differences(command.result(out), command.result(model)) + damages(out) + leftovers(out)

    def fill(self, command: Command, count: int) -> list[str]:
        """Run a command where no file may have more than so many bytes, at some sizes; what is wrong then."""
        model, _ = self.undisturbed(command)
        sizes = sorted({file.stat().st_size for file in model.rglob("*") if file.is_file()})
        wrong = []
        for number in range(count):
            largest = sizes[number * (len(sizes) - 1) // count]  # at least one file does not fit
            out = self.folder / command.name / f"full-{largest}"
            shutil.rmtree(out, ignore_errors=True)
            status, said = self.run(command.arguments(self.folder, out), largest=largest)
            last = said.replace("\r", "\n").strip().splitlines()[-1:]
            if status != 2 or "Traceback" in said or "cannot write" not in "".join(last):
                wrong.append(f"{largest} bytes: status {status}, {said[-500:]}")
            if out.exists():
                wrong += [f"{largest} bytes: {text}" for text in damages(out) + leftovers(out)]
        return wrong

    def _go_on(self, command: Command, out: Path, kill_after: float | None) -> tuple[int, str]:
        if command.is_finished(out):
            return 0, ""
        again = command.going_on if out.exists() else ()
        return self.run([*command.arguments(self.folder, out), *again], kill_after=kill_after)


def damages(out: Path) -> list[str]:
    """Files under their final names that are not whole."""
    found = []
    for file in sorted(out.rglob("*")):
        inside = file.relative_to(out).parts
        if not file.is_file() or any(
            PART_SUFFIX in part or part.startswith(".") or "tmp" in part for part in inside
        ):
            continue
        try:
            if file.suffix in (".png", ".exr"):
                read_image(file)
            elif file.suffix == ".json":
                read_json(file)
            elif file.suffix == ".mp4":
                VideoFrames(open_tree(file), file.name)
            elif file.suffix in (".md", ".html", ".csv", ".safetensors") and not file.stat().st_size:
                raise InputError(f"{file}: empty")
        except (OSError, InputError) as error:
            found.append(f"damaged: {error}")
    return found


def leftovers(out: Path) -> list[str]:
    """Temporary names in a finished run's folder or beside it that are this run's."""
    names = [str(file.relative_to(out.parent)) for file in out.rglob("*")]
    names += [file.name for file in out.parent.glob(f".{out.name}.*")]
    return [f"left over: {name}" for name in names if PART_SUFFIX in name or "orbax-checkpoint-tmp" in name]
