"""Sources that a capture's photos may have been taken under."""

import numpy as np
from jaxtyping import Float

from hyjax.data.capture import Capture
from hyjax.light.kinds import Aperture


def named_sources(
    capture: Capture,
) -> tuple[list[tuple[str, Aperture]], list[tuple[str, Float[np.ndarray, "3"]]]]:
    """Windows and lamps that a capture knows, by name. Whether they were lit is for the fit to find."""
    windows, lamps = [], []
    for name, anchor in sorted(capture.anchors.items()):
        kind, _, number = name.partition("_")
        if kind == "window":
            place = (anchor["center"], anchor["normal"], capture.up, anchor["width"], anchor["height"])
            windows.append((f"window-{int(number) + 1}", Aperture.facing(*place)))
        elif kind == "lamp":
            lamps.append((f"lamp-{int(number) + 1}", np.asarray(anchor["position"], np.float64)))
    return windows, lamps
