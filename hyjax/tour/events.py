"""Handlers of browsers' events on controls and gizmos that all viewers share."""

from collections.abc import Callable, Mapping
from typing import Any

from hyjax.tour.viewer import Viewer
from hyjax.util.memory import release_freed_memory


def change_handler(viewers: Mapping[int, Viewer], handler: Callable[[Any], None]) -> Callable[[Any], Any]:
    """Handler of quick changes, in the order in which they are sent; errors become notices.

    Changes that the server makes to its own controls are not passed on.
    """

    async def handle(event: Any) -> None:
        viewer = viewers.get(event.client_id)
        if event.client is not None and viewer is not None:
            with viewer.show_errors():
                handler(event)

    return handle


def task_handler(viewers: Mapping[int, Viewer], handler: Callable[[Viewer, Any], None]) -> Callable[[Any], None]:
    """Handler of slow requests, on a thread of its own; it is called with the viewer that asks."""

    def handle(event: Any) -> None:
        viewer = viewers.get(event.client_id)
        if viewer is not None:
            with viewer.show_errors():
                handler(viewer, event)
            release_freed_memory()  # of a mesh or a video

    return handle
