"""The checkout that the package runs from, if it runs from one."""

import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]


def commit(root: Path = ROOT) -> str:
    """The checkout's commit, with `-dirty` after it if tracked files differ; `unknown` outside of a checkout.

    Args:
        root: folder of the checkout; a folder inside of one, such as an environment's, is none.
    """
    try:
        if Path(_git(root, "rev-parse", "--show-toplevel")).resolve() != root.resolve():
            return "unknown"
        head = _git(root, "rev-parse", "HEAD")
        return head + ("-dirty" if _git(root, "status", "--porcelain", "--untracked-files=no") else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _git(root: Path, *arguments: str) -> str:
    # Without the lock that `git status` takes: a run that is killed meanwhile would leave it in the checkout.
    command = ["git", "--no-optional-locks", *arguments]
    return subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout.strip()
