"""Plan that is kept in a tour's folder: new visitors, and the next tour there, begin with it."""

import logging
import threading
from pathlib import Path

from msgspec.structs import replace

from hyjax.tour.plan import TourPlan
from hyjax.tour.renderer import Renderer
from hyjax.util.errors import InputError
from hyjax.util.files import make_writable, write_text
from hyjax.util.reading import read_text

PLAN_FILE = "tour.json"
SAVE_DELAY = 0.5
"""Seconds after a change until the plan is written."""
_log = logging.getLogger(__name__)


class KeptPlan:
    """Plan that was set up last.

    Attributes:
        plan: never changed, only replaced.
        notices: what was left out of the file.
    """

    def __init__(self, renderer: Renderer, out: Path) -> None:
        make_writable(out)
        self._renderer, self._file = renderer, out / PLAN_FILE
        self.notices: list[str] = []
        self._lock = threading.Lock()
        self._timer: threading.Timer | None = None
        self.plan = self._read()

    def keep(self, plan: TourPlan) -> None:
        """Write a plan soon."""
        with self._lock:
            if plan == self.plan:
                return
            self.plan = plan
            if self._timer is None:
                self._timer = threading.Timer(SAVE_DELAY, self.save)
                self._timer.daemon = True
                self._timer.start()

    def save(self) -> None:
        """Write the plan now."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()
                self._timer = None
            try:
                write_text(self._file, self.plan.to_json() + "\n")
            except InputError as error:
                _log.warning("%s", error)

    def _read(self) -> TourPlan:
        file, light = self._file, self._renderer.photo_light
        if not file.is_file():
            self._renderer.tell_made_up()
            return self._renderer.first_plan()
        text = read_text(file)
        try:
            plan = TourPlan.from_json(text)
        except InputError as error:
            raise InputError(f"{file}: {error}; remove it to begin anew, or choose another --out") from None
        if light is None or (unknown := light.unknown(plan.existing)) is None:
            return plan
        self.notices.append(f"A plan of another room? {file}: existing: {unknown}. What is unknown is left out.")
        _log.warning("%s: existing: %s; what is unknown is left out", file, unknown)
        known = {name: share for name, share in plan.existing.items() if name in light.estimate.names}
        return replace(plan, existing=known)
