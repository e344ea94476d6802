"""State that all viewers of a tour share: the plan, its selection, and the folder that the plan is saved in."""

import logging
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from hyjax.core.schedule import Schedule
from hyjax.tour.plan import TourPlan
from hyjax.tour.render_queue import RenderQueue
from hyjax.tour.renderer import Renderer
from hyjax.util.errors import InputError
from hyjax.util.files import make_writable, write_text
from hyjax.util.reading import read_text

PLAN_FILE = "tour.json"
SAVE_DELAY = 0.5
"""Seconds after a change until the plan is written."""
Selection = tuple[str, int]
"""A field of the plan and a number in it, as `("lamps", 0)`."""
_log = logging.getLogger(__name__)


class Session:
    """Plan and selection of a running tour, with the functions that are called when they change.

    Attributes:
        plan: what is set up; replaced, never changed.
        selected: the selected lamp, window or piece of furniture; None for nothing.
        notices: what viewers are told when they come: title and text.
        lock: held while the plan or the selection changes.
        on_change: called after the plan has changed, with whether lamps, windows or furniture must be redrawn.
        on_select: called after the selection has changed.

    Args:
        renderer: renders the plan.
        schedules: to choose from, by name; the first is the default.
        out: folder that exports and the plan are written to, and nothing else is.
        queue: renders what the viewers request.
    """

    def __init__(
        self, renderer: Renderer, schedules: Mapping[str, Schedule], out: Path, queue: RenderQueue
    ) -> None:
        make_writable(out)
        self.renderer, self.schedules, self.out, self.queue = renderer, dict(schedules), out, queue
        self.notices: list[tuple[str, str]] = []
        light = renderer.photo_light
        if light is not None and light.estimate.exponent == 0:
            text = f"It could not be estimated well enough: {light.estimate.reason}."
            self.notices.append(("The photos keep their own light", text))
        self.plan = self._load()
        self.selected: Selection | None = None
        self.lock = threading.RLock()
        self.on_change: Callable[[bool], None] = lambda redraw: None
        self.on_select: Callable[[], None] = lambda: None
        self._unused_files: set[str] = set()
        self._save_timer: threading.Timer | None = None

    def change(self, *, redraw: bool = False, **changes: Any) -> None:
        """Replace fields of the plan, for all viewers.

        Args:
            redraw: whether things were added, removed, or moved by something else than their gizmo.
            changes: fields of `TourPlan`.

        Raises:
            InputError: the plan would not be valid; it stays as it was.
        """
        with self.lock:
            before = self.plan
            self.plan = replace(before, **changes).check()
            self._unused_files |= before.files - self.plan.files
        self.on_change(redraw)
        self._save_soon()

    def replace(self, kind: str, index: int, *, redraw: bool = False, **changes: Any) -> None:
        """Change one of the plan's `windows`, `lamps` or `pieces`; nothing if there is none of that number."""
        with self.lock:
            things = list(getattr(self.plan, kind))
            if index < len(things):
                things[index] = replace(things[index], **changes)
                self.change(redraw=redraw, **{kind: tuple(things)})

    def keep_source(self, name: str, factor: float) -> None:
        """Change the factors of one of the photo's own sources."""
        with self.lock:
            kept = {**self.plan.existing, name: factor}
            self.change(existing={source: share for source, share in kept.items() if share > 0})

    def remove(self, kind: str, index: int) -> None:
        """Remove one of the plan's `windows`, `lamps` or `pieces`."""
        with self.lock:
            things = list(getattr(self.plan, kind))
            if index < len(things):
                del things[index]
                self.select(None)
                self.change(redraw=True, **{kind: tuple(things)})

    def add(self, kind: str, thing: Any) -> None:
        """Add to the plan's `windows`, `lamps` or `pieces`, and select it."""
        with self.lock:
            things = (*getattr(self.plan, kind), thing)
            self.change(redraw=True, **{kind: things})
            self.select((kind, len(things) - 1))

    def reset(self) -> None:
        """Set everything up as at the first start."""
        first = self.renderer.first_plan()
        self.select(None)
        self.change(redraw=True, **{name: getattr(first, name) for name in first.__struct_fields__})

    def select(self, selection: Selection | None) -> None:
        """Select a lamp, window or piece; nothing if it does not exist any more."""
        with self.lock:
            self.selected = selection if selection is not None and self.exists(*selection) else None
            self.on_select()

    def exists(self, kind: str, index: int) -> bool:
        """Whether the plan has so many `windows`, `lamps` or `pieces`."""
        return index < len(getattr(self.plan, kind))

    def save(self) -> None:
        """Write the plan, and remove mesh files that it does not name any more."""
        with self.lock:
            if self._save_timer is not None:
                self._save_timer.cancel()
                self._save_timer = None
            try:
                write_text(self.out / PLAN_FILE, self.plan.to_json() + "\n")
                for file in self._unused_files - self.plan.files:  # not before the written plan does without
                    (self.out / file).unlink(missing_ok=True)
                self._unused_files.clear()
            except InputError as error:
                _log.warning("%s", error)

    def _save_soon(self) -> None:
        with self.lock:
            if self._save_timer is None:
                self._save_timer = threading.Timer(SAVE_DELAY, self.save)
                self._save_timer.daemon = True
                self._save_timer.start()

    def _load(self) -> TourPlan:
        file = self.out / PLAN_FILE
        if not file.is_file():
            return self.renderer.first_plan()
        text = read_text(file)
        try:
            return self._known_sources(TourPlan.from_json(text), file)
        except InputError as error:
            raise InputError(f"{file}: {error}; remove it to begin anew, or choose another --out") from None

    def _known_sources(self, plan: TourPlan, file: Path) -> TourPlan:
        """Plan without sources that these photos do not have; viewers get a notice."""
        light = self.renderer.photo_light
        if light is None or (unknown := light.unknown(plan.existing)) is None:
            return plan
        self.notices.append(
            ("A plan of another room?", f"{file}: existing: {unknown}. What is unknown is left out.")
        )
        _log.warning("%s: existing: %s; what is unknown is left out", file, unknown)
        return replace(plan, existing={n: share for n, share in plan.existing.items() if n in light.estimate.names})
