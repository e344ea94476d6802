"""Latest wins: no picture is painted that nobody waits for any more."""

import threading
import time
from collections.abc import Callable, Generator, Hashable, Iterator

import pytest

from hyjax.tour.easel import QUIET, Easel

WAIT = 20.0


class Painter:
    """Paints as slowly as it is let, and remembers what for."""

    def __init__(self, drafts: bool = False) -> None:
        self.painted: list[tuple[Hashable, bool]] = []
        self.free, self.begun = threading.Event(), threading.Event()
        self.drafts = drafts

    def __call__(self, viewer: Hashable, draft: bool) -> bool:
        self.begun.set()
        assert self.free.wait(WAIT)
        if viewer == "broken":
            raise RuntimeError("cannot be painted")
        self.painted.append((viewer, draft))
        return self.drafts and draft

    def until(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + WAIT
        while not condition():
            assert time.monotonic() < end, self.painted
            time.sleep(0.005)


@pytest.fixture
def painter() -> Painter:
    return Painter()


@pytest.fixture
def easel(painter: Painter) -> Iterator[Easel]:
    easel = Easel(painter)
    easel.start()
    yield easel
    painter.free.set()
    easel.stop()


def test_who_has_changed_something_is_known_to_wait(easel: Easel, painter: Painter) -> None:
    easel.want("a")
    assert painter.begun.wait(WAIT)
    assert not easel.pressing, "it is being painted"
    easel.want("b", moved=False)
    assert not easel.pressing, "only time has passed"
    easel.want("b")
    assert easel.pressing


def test_a_slider_dragged_fast_makes_two_pictures(easel: Easel, painter: Painter) -> None:
    """The one that was being painted and the last."""
    easel.want("a")
    assert painter.begun.wait(WAIT)
    for _ in range(1000):
        easel.want("a")
    painter.free.set()
    painter.until(lambda: len(painter.painted) == 2)
    time.sleep(0.1)
    assert painter.painted == [("a", True)] * 2


def test_viewers_take_turns(easel: Easel, painter: Painter) -> None:
    easel.want("a")
    assert painter.begun.wait(WAIT)
    for viewer in "abcab":
        easel.want(viewer)
    painter.free.set()
    painter.until(lambda: len(painter.painted) == 4)
    assert [viewer for viewer, _ in painter.painted] == ["a", "a", "b", "c"]


def test_drafts_become_fine_once_it_is_quiet(easel: Easel, painter: Painter) -> None:
    painter.drafts = True
    painter.free.set()
    begun = time.monotonic()
    easel.want("a", "b")
    painter.until(lambda: len(painter.painted) == 4)
    assert painter.painted == [("a", True), ("b", True), ("a", False), ("b", False)]
    assert time.monotonic() - begun >= QUIET


def test_who_has_left_is_not_painted_for(easel: Easel, painter: Painter) -> None:
    easel.want("a")
    assert painter.begun.wait(WAIT)
    easel.want("b", "c")
    easel.forget("b")
    painter.free.set()
    painter.until(lambda: len(painter.painted) == 2)
    assert [viewer for viewer, _ in painter.painted] == ["a", "c"]


@pytest.mark.filterwarnings("ignore")
def test_an_error_does_not_end_it(easel: Easel, painter: Painter, caplog: pytest.LogCaptureFixture) -> None:
    painter.free.set()
    easel.want("broken")
    easel.want("a")
    painter.until(lambda: bool(painter.painted))
    assert painter.painted == [("a", True)] and "could not be painted" in caplog.text


def test_jobs_make_way(easel: Easel, painter: Painter) -> None:
    painter.free.set()
    order: list[str] = []

    def job() -> Generator[None]:
        for step in "123":
            order.append(step)
            if step == "1":
                easel.want("a")
                easel.want("b")
            if step == "2":
                order.extend(str(viewer) for viewer, _ in painter.painted)
            yield

    easel.work_on(job())
    painter.until(lambda: "3" in order)
    assert order == ["1", "2", "a", "b", "3"]


def test_time_that_passes_does_not_keep_pictures_coarse_nor_jobs_waiting(easel: Easel, painter: Painter) -> None:
    """As with a candle, which asks for a picture several times a second."""
    painter.drafts = True
    painter.free.set()
    steps: list[int] = []

    def job() -> Generator[None]:
        for step in range(3):
            steps.append(step)
            yield

    easel.want("a")
    easel.work_on(job())
    end = time.monotonic() + WAIT
    while ("a", False) not in painter.painted or len(steps) < 3:
        assert time.monotonic() < end
        easel.want("a", moved=False)
        time.sleep(0.5 * QUIET)


def test_pictures_that_are_always_wanted_again_leave_every_other_turn(painter: Painter) -> None:
    """Candles of more visitors than can be painted for."""
    painter.drafts = True
    painter.free.set()
    easel, steps = Easel(lambda viewer, draft: again(viewer, draft)), []

    def again(viewer: Hashable, draft: bool) -> bool:
        easel.want(viewer, moved=False)
        return painter(viewer, draft)

    def job() -> Generator[None]:
        for step in range(3):
            steps.append(step)
            yield

    easel.want("a", "b", moved=False)
    easel.work_on(job())
    easel.start()
    painter.until(lambda: {("a", False), ("b", False)} <= set(painter.painted))
    painter.drafts = False
    painter.until(lambda: len(steps) == 3)
    easel.stop()
    assert painter.painted.count(("a", True)) > 1


def test_a_picture_that_was_given_up_is_painted_once_there_is_time(easel: Easel, painter: Painter) -> None:
    painter.free.set()
    given_up = iter([True, True, False])
    calls: list[bool] = []
    easel._paint = lambda viewer, draft: calls.append(draft) or next(given_up)  # type: ignore[func-returns-value]
    easel.want("a")
    painter.until(lambda: len(calls) == 3)
    assert calls == [True, False, False]


def test_a_job_that_fails_is_dropped(easel: Easel, painter: Painter, caplog: pytest.LogCaptureFixture) -> None:
    painter.free.set()

    def job() -> Generator[None]:
        yield
        raise OSError("disk full")

    easel.work_on(job())
    painter.until(lambda: "disk full" in caplog.text)
    easel.want("a")
    painter.until(lambda: bool(painter.painted))
