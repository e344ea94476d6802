"""Render queue: the latest request wins, and finer pictures and jobs wait."""

import threading
import time
from collections.abc import Callable, Generator, Hashable, Iterator

import pytest

from hyjax.tour.render_queue import QUIET_SECONDS, RenderQueue

WAIT = 20.0


class SlowRenderer:
    """Renders once it is let go on, and records what."""

    def __init__(self, drafts: bool = False) -> None:
        self.rendered: list[tuple[Hashable, bool]] = []
        self.free, self.begun = threading.Event(), threading.Event()
        self.drafts = drafts

    def __call__(self, viewer: Hashable, draft: bool) -> bool:
        self.begun.set()
        assert self.free.wait(WAIT)
        if viewer == "broken":
            raise RuntimeError("cannot be rendered")
        self.rendered.append((viewer, draft))
        return self.drafts and draft

    def until(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + WAIT
        while not condition():
            assert time.monotonic() < end, self.rendered
            time.sleep(0.005)


@pytest.fixture
def renderer() -> SlowRenderer:
    return SlowRenderer()


@pytest.fixture
def queue(renderer: SlowRenderer) -> Iterator[RenderQueue]:
    queue = RenderQueue(renderer)
    queue.start()
    yield queue
    renderer.free.set()
    queue.stop()


def test_only_a_change_makes_a_request_interactive(queue: RenderQueue, renderer: SlowRenderer) -> None:
    queue.request("a")
    assert renderer.begun.wait(WAIT)
    assert not queue.has_interactive, "it is being rendered"
    queue.request("b", interactive=False)
    assert not queue.has_interactive, "only time has passed"
    queue.request("b")
    assert queue.has_interactive


def test_a_slider_dragged_fast_renders_two_pictures(queue: RenderQueue, renderer: SlowRenderer) -> None:
    """The one that was being rendered and the last."""
    queue.request("a")
    assert renderer.begun.wait(WAIT)
    for _ in range(1000):
        queue.request("a")
    renderer.free.set()
    renderer.until(lambda: len(renderer.rendered) == 2)
    time.sleep(0.1)
    assert renderer.rendered == [("a", True)] * 2


def test_viewers_take_turns(queue: RenderQueue, renderer: SlowRenderer) -> None:
    queue.request("a")
    assert renderer.begun.wait(WAIT)
    for viewer in "abcab":
        queue.request(viewer)
    renderer.free.set()
    renderer.until(lambda: len(renderer.rendered) == 4)
    assert [viewer for viewer, _ in renderer.rendered] == ["a", "a", "b", "c"]


def test_drafts_are_rendered_finely_once_it_is_quiet(queue: RenderQueue, renderer: SlowRenderer) -> None:
    renderer.drafts = True
    renderer.free.set()
    begun = time.monotonic()
    queue.request("a", "b")
    renderer.until(lambda: len(renderer.rendered) == 4)
    assert renderer.rendered == [("a", True), ("b", True), ("a", False), ("b", False)]
    assert time.monotonic() - begun >= QUIET_SECONDS


def test_a_viewer_who_has_left_gets_no_picture(queue: RenderQueue, renderer: SlowRenderer) -> None:
    queue.request("a")
    assert renderer.begun.wait(WAIT)
    queue.request("b", "c")
    queue.remove("b")
    renderer.free.set()
    renderer.until(lambda: len(renderer.rendered) == 2)
    assert [viewer for viewer, _ in renderer.rendered] == ["a", "c"]


@pytest.mark.filterwarnings("ignore")
def test_an_error_does_not_end_the_thread(
    queue: RenderQueue, renderer: SlowRenderer, caplog: pytest.LogCaptureFixture
) -> None:
    renderer.free.set()
    queue.request("broken")
    queue.request("a")
    renderer.until(lambda: bool(renderer.rendered))
    assert renderer.rendered == [("a", True)] and "could not be rendered" in caplog.text


def test_jobs_wait_for_pictures(queue: RenderQueue, renderer: SlowRenderer) -> None:
    renderer.free.set()
    order: list[str] = []

    def job() -> Generator[None]:
        for step in "123":
            order.append(step)
            if step == "1":
                queue.request("a")
                queue.request("b")
            if step == "2":
                order.extend(str(viewer) for viewer, _ in renderer.rendered)
            yield

    queue.add_job(job())
    renderer.until(lambda: "3" in order)
    assert order == ["1", "2", "a", "b", "3"]


def test_flickering_delays_neither_fine_pictures_nor_jobs(queue: RenderQueue, renderer: SlowRenderer) -> None:
    """As with a candle, which asks for a picture several times a second."""
    renderer.drafts = True
    renderer.free.set()
    steps: list[int] = []

    def job() -> Generator[None]:
        for step in range(3):
            steps.append(step)
            yield

    queue.request("a")
    queue.add_job(job())
    end = time.monotonic() + WAIT
    while ("a", False) not in renderer.rendered or len(steps) < 3:
        assert time.monotonic() < end
        queue.request("a", interactive=False)
        time.sleep(0.5 * QUIET_SECONDS)


def test_requests_without_end_leave_every_other_turn(renderer: SlowRenderer) -> None:
    """Candles of more viewers than can be rendered for."""
    renderer.drafts = True
    renderer.free.set()
    queue, steps = RenderQueue(lambda viewer, draft: again(viewer, draft)), []

    def again(viewer: Hashable, draft: bool) -> bool:
        queue.request(viewer, interactive=False)
        return renderer(viewer, draft)

    def job() -> Generator[None]:
        for step in range(3):
            steps.append(step)
            yield

    queue.request("a", "b", interactive=False)
    queue.add_job(job())
    queue.start()
    renderer.until(lambda: {("a", False), ("b", False)} <= set(renderer.rendered))
    renderer.drafts = False
    renderer.until(lambda: len(steps) == 3)
    queue.stop()
    assert renderer.rendered.count(("a", True)) > 1


def test_a_cancelled_picture_is_rendered_once_there_is_time(queue: RenderQueue, renderer: SlowRenderer) -> None:
    renderer.free.set()
    given_up = iter([True, True, False])
    calls: list[bool] = []
    queue._render = lambda viewer, draft: calls.append(draft) or next(given_up)  # type: ignore[func-returns-value]
    queue.request("a")
    renderer.until(lambda: len(calls) == 3)
    assert calls == [True, False, False]


def test_a_job_that_fails_is_dropped(
    queue: RenderQueue, renderer: SlowRenderer, caplog: pytest.LogCaptureFixture
) -> None:
    renderer.free.set()

    def job() -> Generator[None]:
        yield
        raise OSError("disk full")

    queue.add_job(job())
    renderer.until(lambda: "disk full" in caplog.text)
    queue.request("a")
    renderer.until(lambda: bool(renderer.rendered))
