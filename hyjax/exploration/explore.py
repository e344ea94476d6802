"""Explore a scene in a notebook."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hyjax.light.setup import LightSetup
from hyjax.scene.scene import AnyConfiguration, AnyLights, Scene
from hyjax.scene.settings import SceneSettings
from hyjax.util.arguments import checked_arguments
from hyjax.util.extras import optional_module

if TYPE_CHECKING:
    from hyjax.exploration.widget import Explorer


KEPT_MAPS = 6
"""Sets of shadow maps that are kept: of wholes and drafts, before and after a lamp was moved."""


@checked_arguments
def explore(
    scene: Scene | Path | str,
    *,
    frame: int = 0,
    lights: AnyLights = "evening-lamps",
    configuration: AnyConfiguration = None,
    truth: Callable[[int, LightSetup], Any] | None = None,
) -> "Explorer":
    """Widget of a notebook that relights a scene's frames while lights and choices are changed by hand.

    Args:
        scene: a scene, or a capture's folder or archive.
        frame: position of the first one that is shown.
        lights: lights, a set-up, or its name or file.
        configuration: see `Scene.relit`.
        truth: function from a frame's position and a `LightSetup` to the picture that it should be, (h, w, 3)
            display values, or None. Loss and metrics against it are shown. Default: that of a generated room.

    Raises:
        InputError: the extra `notebooks` is not installed, or any of these cannot be used.

    Example:
        widget = hyjax.explore("my_scan", lights="golden-hour")
        widget.configuration = "fast"
        widget  # as the last line of a cell
    """
    optional_module("anywidget", "notebooks", "explore")
    from hyjax.exploration.widget import Explorer

    opened = scene if isinstance(scene, Scene) else Scene.open(SceneSettings(capture=Path(scene)))
    opened.maps_on_disk = False  # or a lamp that is dragged would fill the cache folder
    opened.kept_maps.most = max(KEPT_MAPS, opened.kept_maps.most)
    return Explorer(opened, frame=frame, lights=lights, configuration=configuration, truth=truth)
