"""Checkpoints of a training run, written atomically; only the last good ones are kept.

Orbax writes to a temporary folder and renames it, so that a run killed at any moment finds its last checkpoint
whole. A checkpoint holds the state and the position in the stream of crops."""

import functools
import logging
from pathlib import Path
from typing import Any

import jax
import orbax.checkpoint as ocp

from hyjax.training.state import TrainState
from hyjax.util.errors import InputError

KEPT_COUNT = 2
"""Number of kept checkpoints."""


class Checkpoints:
    """Checkpoints in a folder, which is made with the first one.

    Methods raise `InputError` if the folder cannot be used.
    """

    def __init__(self, folder: Path) -> None:
        logging.getLogger("absl").setLevel(logging.ERROR)  # Orbax tells of every file it writes
        self.folder = folder

    @functools.cached_property
    def _manager(self) -> ocp.CheckpointManager:
        # Written before training goes on: a copy kept in memory meanwhile would cost as much as it saves.
        options = ocp.CheckpointManagerOptions(
            max_to_keep=KEPT_COUNT, enable_async_checkpointing=False, cleanup_tmp_directories=True
        )
        try:
            return ocp.CheckpointManager(self.folder.absolute(), options=options)
        except OSError as error:
            raise InputError(f"{self.folder}: cannot keep checkpoints there ({error.strerror or error})") from None

    def latest(self) -> int | None:
        """Iteration of the newest checkpoint."""
        return self._manager.latest_step() if self.folder.is_dir() else None

    def save(self, state: TrainState, position: Any) -> None:
        """Write a checkpoint, if there is none: a state and the position in the stream of crops (JSON's types)."""
        if self.latest() == int(state.iteration):
            return
        items = ocp.args.Composite(state=ocp.args.StandardSave(state), position=ocp.args.JsonSave(position))
        try:
            self._manager.save(int(state.iteration), args=items, force=True)
            self._manager.wait_until_finished()
        except OSError as error:
            raise InputError(f"{self.folder}: cannot write a checkpoint ({error.strerror or error})") from None

    def restore(self, like: TrainState) -> tuple[TrainState, Any]:
        """Read the newest checkpoint, for a state of the same shapes as `like`."""
        abstract = jax.tree.map(ocp.utils.to_shape_dtype_struct, like)
        items = ocp.args.Composite(state=ocp.args.StandardRestore(abstract), position=ocp.args.JsonRestore())
        latest = self.latest()
        try:
            restored = self._manager.restore(latest, args=items)
        except (OSError, ValueError, KeyError) as error:
            first = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(
                f"{self.folder}: checkpoint {latest} cannot be read ({first}); remove it to use the one before"
            ) from None
        return restored.state, restored.position

    def close(self) -> None:
        """Release the folder."""
        if "_manager" in vars(self):
            self._manager.close()
