"""What commands say on stderr: one line, from their first moment on."""

import logging
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import pytest

from hyjax import cli
from hyjax.relighting.settings import RelightSettings
from hyjax.util.progress import command_bar
from hyjax.util.terminal import OneLine, quiet_libraries

INTERRUPTED_WHILE_LOADING = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.{handler})

class Interrupt:
    def find_spec(self, name, *_):
        if name == "tyro":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupt())
sys.argv = ["hyjax", "--version"]
from hyjax.__main__ import main
main()
"""


@pytest.mark.parametrize(
    ("handler", "status", "said"),
    [("default_int_handler", 130, "hyjax: interrupted; the files written so far are whole\n"), ("SIG_IGN", 0, "")],
)
def test_an_interrupt_while_modules_load_is_one_line(handler: str, status: int, said: str) -> None:
    code = INTERRUPTED_WHILE_LOADING.format(handler=handler)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (status, said)


@pytest.mark.skipif(sys.platform == "win32", reason="has no such signals")
def test_an_interrupt_at_the_end_is_one_line() -> None:
    """Where all is written, and a thread still compiles for the next start."""
    code = (
        "import signal, threading, time\nfrom hyjax import __main__, cli\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # which a background job's tests would ignore
        "def done():\n    threading.Thread(target=time.sleep, args=(60,)).start()\n    print('done', flush=True)\n"
        "cli.main = done\n__main__.main()"
    )
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", code], text=True, **pipes) as ended:
        assert ended.stdout is not None and ended.stdout.readline() == "done\n"
        time.sleep(0.5)  # the main thread waits for the other
        ended.send_signal(signal.SIGINT)
        _, said = ended.communicate(timeout=10)
    assert (ended.returncode, said) == (130, "hyjax: interrupted; the files written so far are whole\n")


@pytest.mark.parametrize("command", ["info", "--version"])
@pytest.mark.parametrize(
    ("redirection", "status", "said"),
    [
        (">&-", 0, ""),
        ("2>&- >/dev/null", 0, ""),
        (">/dev/full", 2, "hyjax: stdout: cannot be written to: No space"),
    ],
)
def test_output_that_goes_nowhere(redirection: str, status: int, said: str, command: str) -> None:
    line = f"exec {sys.executable} -m hyjax {command} {redirection}"
    done = subprocess.run(["sh", "-c", line], capture_output=True, text=True, timeout=60)
    assert done.returncode == status and done.stderr.startswith(said) and done.stderr.count("\n") == bool(said)


def test_live_frames_from_a_closed_stdin_are_none() -> None:
    code = "from hyjax.util.terminal import open_closed_streams as open; open()\n"
    code += "from hyjax.live.source import live_frames; print(list(live_frames('-')))"
    command = f'exec {sys.executable} -c "{code}" <&-'
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, "[]\n", "")


@pytest.mark.parametrize("option", ["--nosuch", "--renderer", "--size"])
def test_long_arguments_are_not_repeated(
    option: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["hyjax", "relight", option, "9" * 5000])
    monkeypatch.setitem(cli.RUNNERS, RelightSettings, lambda settings: settings.check())
    with pytest.raises(SystemExit, match="2"):
        cli.main()
    said = capsys.readouterr().err
    assert 0 < said.count("9") < 650


def test_help_beside_a_long_argument_comes_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["hyjax", "relight", "--help", "9" * 5000])
    with pytest.raises(SystemExit, match="0"):
        cli.parse()
    assert capsys.readouterr().out.count("usage: hyjax") == 1


@pytest.mark.parametrize(
    "arguments, line",
    [
        (
            ["relight", "--lihgts", "night"],
            "Unrecognized options: --lihgts, night; perhaps --lights; see hyjax relight --help",
        ),
        (
            ["relight", "--light", "night"],
            "Unrecognized options: --light, night; perhaps --lights; see hyjax relight --help",
        ),
        (
            ["relight", "--seed", "x"],
            "--seed: need a whole number, got 'x'; see hyjax relight --help",
        ),
        (["relight", "--kappa", "x"], "--kappa: need a number, got 'x'; see hyjax relight --help"),
        (["relight", "--sampling", "1.5"], "--sampling: need a whole number, got '1.5'; see hyjax relight --help"),
        (["tune", "--fps", "x"], "--fps: cannot be 'x'; see hyjax tune --help"),
        (
            ["info", "--frames", "x"],
            "Unrecognized or misplaced options: --frames (applied to hyjax info) x (applied to hyjax info), which "
            "other commands have; see hyjax info --help",
        ),
        (
            ["relight", "--size"],
            "Missing value for argument '--size'. Expected 1 values; see hyjax relight --help",
        ),
        (
            ["relite"],
            "'relite': no such command (did you mean 'relight'?); there are relight, tune, sweep, train, tour, "
            "export, serve, convert, info",
        ),
        ([], "give a command, as in hyjax relight; see hyjax --help"),
        (["--lights", "night"], "--lights: a command comes first, as in hyjax relight; see hyjax --help"),
        (
            ["export", "--to", "webb"],
            "invalid choice 'webb' for argument '--to'. Expected one of ('web', 'bench', 'stablehlo', 'iree', "
            "'onnx', 'litert', 'coreml') (did you mean 'web'?); see hyjax export --help",
        ),
        (
            ["relight", "--lihgts", "x", "--fram", "0"],
            "Unrecognized options: --lihgts, x, --fram, 0; perhaps --lights for --lihgts; perhaps --frames for "
            "--fram; see hyjax relight --help",
        ),
        (["relight", "kitchen"], "kitchen: is no option; a capture is given as --capture kitchen"),
        (
            ["info", "--capture", "kitchen"],
            "--capture: is no option here; the capture is given by itself: hyjax info PATH",
        ),
    ],
)
def test_a_usage_error_is_one_line(
    arguments: list[str], line: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["hyjax", *arguments])
    with pytest.raises(SystemExit, match="2"):
        cli.main()
    assert capsys.readouterr().err == f"hyjax: {line}\n"


def test_notes_of_the_reader_of_options_are_not_lost(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def read(*_: object, **__: object) -> str:
        print("a note", file=sys.stderr)
        return "command"

    monkeypatch.setattr(cli.tyro, "cli", read)
    monkeypatch.setattr(sys, "argv", ["hyjax", "relight"])
    assert cli.parse() == "command" and capsys.readouterr().err == "a note\n"


def test_a_logged_message_is_one_line_and_a_traceback_below_it_is_not() -> None:
    formatter = OneLine("hyjax: %(message)s")
    record = logging.LogRecord("a", logging.WARNING, "a.py", 1, "%s: damaged", ("a\nb" * 1000,), None)
    text = formatter.format(record)
    assert "\n" not in text and len(text) < 1300 and text.startswith("hyjax: a\\nb")
    record.exc_info = (ValueError, ValueError("told"), None)
    assert formatter.format(record).splitlines()[-1] == "ValueError: told"


def test_warnings_are_one_line_and_those_of_numbers_none(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "warnoptions", [])
    with warnings.catch_warnings():
        warnings.resetwarnings()
        quiet_libraries()
        warnings.warn("invalid value encountered in divide", RuntimeWarning, stacklevel=1)
        warnings.warn("a\nb", UserWarning, stacklevel=1)
    assert capsys.readouterr().err == "hyjax: a\\nb\n"


BARS = """
import logging, sys
from hyjax.util.terminal import quiet_libraries
quiet_libraries()
from hyjax.util.progress import StepBar, command_bar
with command_bar("relighting", "frame", disable=False) as bar:
    for _ in StepBar(range(1000), "fusing", unit="frame"):
        pass
    for number in bar.count(iter(range(1000)), 1000):
        if number == 500:
            logging.getLogger("hyjax").warning("frame %d is odd", number)
logging.getLogger("hyjax").warning("%d", "no number")
print("on")
"""


def test_what_a_file_has_of_bars_and_messages(tmp_path: Path) -> None:
    """Each message on a line of its own, and few states of the bars."""
    with (tmp_path / "log").open("w") as log:
        done = subprocess.run(
            [sys.executable, "-c", BARS], stdout=subprocess.PIPE, stderr=log, text=True, check=True
        )
    text = (tmp_path / "log").read_text()
    assert "hyjax: frame 500 is odd" in text.splitlines() and "relighting: 100%" in text
    assert len(text.split("\r")) < 12 and done.stdout == "on\n", "a message that cannot be made ends nothing"


@pytest.mark.parametrize("end", ["2> /dev/full", "2>&-"])
def test_messages_that_cannot_be_written_end_nothing(end: str) -> None:
    command = f'exec "$0" -c "$1" {end}'
    script = "import logging; from hyjax.util.terminal import quiet_libraries; quiet_libraries();"
    script += "logging.getLogger('hyjax').warning('odd'); print('on')"
    done = subprocess.run(["bash", "-c", command, sys.executable, script], stdout=subprocess.PIPE, text=True)
    assert done.returncode in (0, 120) and done.stdout == "on\n"  # 120: Python's own, of streams at the end


def test_messages_stand_above_a_bar_in_a_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(logging.getLogger(), "handlers", [])
    with warnings.catch_warnings():
        quiet_libraries()
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with command_bar("relighting", "frame", disable=False) as bar:
        assert bar is not None
        for number in bar.count(iter(range(2)), 2):
            logging.getLogger("hyjax").warning("frame %d is odd", number)
    lines = capsys.readouterr().err.split("\n")
    assert [line.rsplit("\r", 1)[-1] for line in lines[:2]] == [
        "hyjax: frame 0 is odd",
        "hyjax: frame 1 is odd",
    ]
