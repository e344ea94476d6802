"""Study: the trials of a search, in Optuna's journal, from which an interrupted search goes on.

The journal is one file that several processes may append to; `optuna-dashboard study.log` shows it. A trial's
values are its loss and time relative to the default's. What did not fit the budget is in it as well: which trial
fits is told by the measured time alone.

Losses hold on any machine. Times are kept by machine: a search that goes on elsewhere measures them anew.
"""

import contextlib
import dataclasses
import logging
import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from hyjax.tuning.budget import MOST_STEPS
from hyjax.tuning.space import Parameter, Space, key_of
from hyjax.tuning.trial import Trial
from hyjax.util.errors import InputError
from hyjax.util.extras import optional_module
from hyjax.util.reading import check_regular
from hyjax.util.run_log import as_json, check_same_settings

if TYPE_CHECKING:
    import optuna

FILE_NAME = "study.log"
UNUSABLE_LOSS = 1e9
"""Stands for a loss that is not a number."""
VERSION = 6
"""Version of the journal. Add one whenever its contents mean something else."""
_log = logging.getLogger(__name__)
KEPT_FIELDS = ("choices", "phase", "losses", "time", "cases", "improve", "source", "predicted")
"""Fields that are kept of a trial; its budget is known while it is proposed alone."""


@contextlib.contextmanager
def _quietly() -> Iterator[None]:
    """Suppress Optuna's own warnings about a damaged journal."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


class Study:
    """Trials of a search and other results by key, on disk as they come.

    Attributes:
        trials: those that were kept, in their order; without a time where another machine took it.

    Args:
        folder: where `study.log` is kept; None keeps it in memory.
    """

    @_quietly()
    def __init__(
        self, folder: Path | None, name: str, settings: dict[str, Any], *, machine: str = "", resume: bool = False
    ) -> None:
        self.name, self.machine = name, machine
        self.trials, self._results, self._study = list[Trial](), dict[str, Any](), None
        if folder is None:
            return
        check_installed()
        import optuna

        path = folder / FILE_NAME
        check_free(folder, resume)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if path.exists():
                _cut_to_lines(path)
            storage = _storage(path)
            if name in optuna.get_all_study_names(storage):  # a run that is refused writes nothing
                self._study = optuna.load_study(study_name=name, storage=storage)
            else:
                self._study = optuna.create_study(
                    storage=storage, study_name=name, directions=["minimize", "minimize"]
                )
            attributes = self._study.user_attrs
        except OSError as error:
            raise InputError(f"{path}: cannot write ({error.strerror or error})") from None
        except Exception as error:  # whatever a damaged journal makes of Optuna
            raise InputError(f"{path}: is no journal of a study ({type(error).__name__}); remove it") from None
        if attributes and attributes.get("version") != VERSION:
            raise InputError(
                f"{path}: trials of version {attributes.get('version')} of the search, this is {VERSION}; they "
                "cannot be gone on with, choose another --out"
            )
        if attributes:
            if not isinstance(attributes.get("settings"), dict):
                raise InputError(f"{path}: has no settings of a study; remove it")
            check_same_settings(folder, attributes["settings"], as_json(settings))
        try:
            if not attributes:
                self._study.set_user_attr("settings", as_json(settings))
                self._study.set_user_attr("version", VERSION)
            self.trials = _merged([_trial(trial) for trial in self._study.get_trials(deepcopy=False)], machine)
        except OSError as error:
            raise InputError(f"{path}: cannot write ({error.strerror or error})") from None
        except Exception as error:  # as above
            raise InputError(f"{path}: holds no trials of a search ({type(error).__name__}); remove it") from None
        self._results = {key: value for key, value in attributes.items() if key.startswith("result ")}

    def timed(self, key: str) -> str:
        """Key of a time, which is of this machine alone."""
        return f"{key} on {self.machine}"

    def remember(self, key: str, compute: Callable[[], Any], *, expired: Callable[[], bool] = lambda: False) -> Any:
        """Result of `compute`, which is called at most once for each key; of no trial in particular.

        Args:
            expired: whether the time was up before it was done: such a result is not kept on disk.
        """
        name = f"result {key}"
        if name not in self._results:
            self._results[name] = as_json(compute())
            if not expired() and self._study is not None:
                try:
                    self._study.set_user_attr(name, self._results[name])
                except OSError as error:
                    raise _unwritable(error) from None
                except ValueError as error:  # Optuna reads the journal again
                    raise InputError(
                        f"{FILE_NAME}: is no journal of a study ({type(error).__name__}); remove it"
                    ) from None
        return self._results[name]

    def add(self, space: Space, trial: Trial) -> None:
        """Add a judged trial."""
        if self._study is None:
            return
        import optuna

        values = {n: space.named[n].middle(v) if isinstance(v, tuple) else v for n, v in trial.choices.items()}
        loss = trial.loss if math.isfinite(trial.loss) else UNUSABLE_LOSS
        content = {name: getattr(trial, name) for name in KEPT_FIELDS} | {"machine": self.machine}
        try:
            self._study.add_trial(
                optuna.trial.create_trial(
                    params=values,
                    distributions={name: _distribution(space.named[name]) for name in values},
                    values=[loss, 1.0 if trial.time is None else trial.time],
                    user_attrs=as_json(content),
                )
            )
        except OSError as error:
            raise _unwritable(error) from None


def _storage(path: Path) -> "optuna.storages.JournalStorage":
    import optuna
    from optuna.storages.journal import JournalFileBackend

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    return optuna.storages.JournalStorage(JournalFileBackend(str(path)))


def _unwritable(error: OSError) -> InputError:
    return InputError(f"{FILE_NAME}: cannot write ({error.strerror or error})")


def _cut_to_lines(path: Path) -> None:
    """Remove a last line that a crash has cut off: appended lines would become part of it."""
    check_regular(path)
    with path.open("rb+") as file:
        content = file.read()
        if not content.endswith(b"\n"):
            file.truncate(content.rfind(b"\n") + 1)


@_quietly()
def kept_trials(path: Path, name: str = "frame") -> list[Trial]:
    """Trials of a journal of any machine and settings, to be read only."""
    check_installed()
    import optuna

    check_regular(path)
    found: dict[str, Trial] = {}
    try:
        study = optuna.load_study(study_name=name, storage=_storage(path))
        for kept in study.get_trials(deepcopy=False):
            trial, _ = _trial(kept)
            before = found.get(key := key_of(trial.choices))
            if before is None or "results" not in kept.user_attrs:
                found[key] = max(before or trial, trial, key=lambda t: len(t.losses))
            else:
                found[key] = dataclasses.replace(before, losses=before.losses + trial.losses)
    except Exception as error:  # whatever a damaged journal makes of Optuna, and of what is asked for
        raise InputError(f"{path}: has no trials of {name!r}, or is damaged ({type(error).__name__})") from None
    return list(found.values())


def _trial(kept: "optuna.trial.FrozenTrial") -> tuple[Trial, str]:
    """Trial as it was kept, and the machine that timed it."""
    attributes, values = kept.user_attrs, kept.values
    if "results" in attributes:  # of versions 1 and 2, in which each batch was a trial of its own
        results = attributes["results"].items()
        losses = [loss for of, several in results if of.startswith("losses ") for loss in several]
        choices = {name.replace(" ", "_"): value for name, value in kept.params.items()}  # version 1 had blanks
        return Trial(choices, attributes["phase"], tuple(losses), values[1]), ""
    trial = msgspec.convert({name: attributes[name] for name in KEPT_FIELDS}, Trial)
    choices = {name: tuple(v) if isinstance(v, list) else v for name, v in trial.choices.items()}
    return dataclasses.replace(trial, choices=choices), str(attributes["machine"])


def _merged(kept: Sequence[tuple[Trial, str]], machine: str) -> list[Trial]:
    """Trials in their order, each with all of its losses, and with its time if this machine took it."""
    found: dict[tuple[str, str, str], Trial] = {}
    for trial, on in kept:
        key = key_of(trial.choices), trial.improve, trial.source
        before, time = found.get(key, trial), trial.time if on == machine else None
        losses = max(before.losses, trial.losses, key=len)
        old_time = found[key].time if key in found else None
        found[key] = dataclasses.replace(before, losses=losses, time=old_time if time is None else time)
    return list(found.values())


def _distribution(parameter: Parameter) -> "optuna.distributions.BaseDistribution":
    import optuna

    if parameter.factor:
        return optuna.distributions.IntDistribution(0, MOST_STEPS)
    if parameter.continuous:
        low, high = parameter.values
        return optuna.distributions.FloatDistribution(low, high, log=parameter.log)
    return optuna.distributions.CategoricalDistribution(parameter.values)


def check_free(folder: Path, resume: bool) -> None:
    """Raise `InputError` if the folder holds a run that is not to be resumed."""
    if not resume and (folder / FILE_NAME).exists():
        raise InputError(
            f"{folder}: holds the trials of another run; add --resume to go on with it, or choose another --out"
        )
    if resume and not (folder / FILE_NAME).exists():
        _log.warning("%s: has no trials to go on with (--resume); a new search begins", folder)


def check_installed() -> None:
    """Raise `InputError` unless Optuna and Matplotlib are there."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of tqdm, in notebooks without widgets
        for module in ("matplotlib", "optuna"):
            optional_module(module, "tune", "tune")
