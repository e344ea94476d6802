"""Photo's own light of a scene: estimated once, kept in the cache folder, joined by the bounces of new lights."""

import functools
import hashlib
import logging
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hyjax.data.capture import Capture, Frame
from hyjax.data.frames import SMALL_WIDTH, forget_small_frames, shrink, small_frame, spread
from hyjax.geometry.raycast import RayCaster
from hyjax.light.emission import Emitters, radiant_filter
from hyjax.light.panes import Bars
from hyjax.light.photo_light import PhotoLight, SurfaceLight, bounced_light
from hyjax.light.setup import LightSetup, same_setup
from hyjax.light.shadow_map import ShadowMap
from hyjax.photo_light.belief import EXPONENTS
from hyjax.photo_light.estimate import Estimate, estimate_arrays, read_estimate, trace_scan
from hyjax.photo_light.hints import hinted_windows
from hyjax.photo_light.source_arrays import sources_from_arrays, sources_to_arrays
from hyjax.photo_light.sources import PhotoSources
from hyjax.photo_light.window_bars import pane_arrays
from hyjax.util.cache import Arrays, cache_folder, cached_arrays
from hyjax.util.errors import InputError, did_you_mean
from hyjax.util.files import digest
from hyjax.util.prefetch import prefetch
from hyjax.util.programs import run_kept

FRAME_COUNT = 24
"""Number of frames, spread over the capture, for the estimate of the photo's light."""
VERSION = 41
"""Version of sources and estimate. Add one when either changes."""
PANES = ("bar_spans", "bar_recess", "pane_means")
"""Names of the arrays of `pane_arrays`."""
_log = logging.getLogger(__name__)
_Stored = tuple[Estimate, Arrays]


class ScenePhotoLight:
    """Photo's own light of a scene's frames, computed on demand.

    Args:
        size: (height, width) that is worked at; None as captured. Frames are no larger, and not cropped.
        sources_file: names the windows and lamps that lit the frames; None to find them.
    """

    def __init__(
        self,
        capture: Capture,
        caster: RayCaster,
        *,
        size: tuple[int, int] | None = None,
        sources_file: Path | None = None,
        progress: bool = False,
    ) -> None:
        self._capture, self._caster = capture, caster
        self._size, self._sources_file, self._progress = size, sources_file, progress
        self._last: tuple[LightSetup, Sequence[ShadowMap | None] | None, SurfaceLight] | None = None
        self._begun: Future[_Stored] | None = None
        self._expected: Future[PhotoLight | None] = Future()
        self._lock = threading.Lock()
        self._sources: PhotoSources | None = None

    @property
    def sources(self) -> PhotoSources:
        """Windows and lamps that lit the frames."""

        def found() -> Arrays:
            from hyjax.photo_light.source_search import find_photo_sources  # slow to load

            return sources_to_arrays(
                find_photo_sources(self._capture, self._caster, self._frames, file=self._sources_file)
            )

        file = cache_folder() / f"photo-sources-v{VERSION}-{self._key}.npz"
        with self._lock:  # asked for by several threads
            if self._sources is None:
                self._sources = cached_arrays(file, sources_from_arrays, found)
            return self._sources

    def begin(self) -> bool:
        """Begin the estimate on a thread of its own, unless it is kept or known; whether it was begun now.

        Whoever asks for the light, or for its sources, waits for them.
        """
        if self._begun is not None or "_stored" in self.__dict__ or self._file.is_file():
            return False
        pool = ThreadPoolExecutor(1, thread_name_prefix="photo-light")
        self._begun = pool.submit(self._read_or_made)
        self._begun.add_done_callback(lambda _: self._expect(None))  # of an estimate that failed early
        pool.shutdown(wait=False)
        return True

    def expected(self) -> PhotoLight | None:
        """Shapes of the light of an estimate that was begun, waited for until they are known; None for none."""
        return None if self._begun is None else self._expected.result()

    def _expect(self, light: PhotoLight | None) -> None:
        if not self._expected.done():
            self._expected.set_result(light)

    @functools.cached_property
    def estimate(self) -> Estimate:
        """Estimate of the light."""
        found = self._stored[0]
        if found.exponent == 0:
            _log.warning("%s: %s", self._capture.name, self.summary(found))
        return found

    def surface_light(self, setup: LightSetup, shadow_maps: Sequence[ShadowMap | None] | None) -> SurfaceLight:
        """Photo's light and the bounces of new lights on the vertices, with a cache of the last set-up."""
        last = self._last
        if last is not None and last[1] is shadow_maps and same_setup(last[0], setup):
            return last[2]
        bounced = bounced_light(self.estimate.light, setup.lights, shadow_maps, run=run_kept)
        light = self.with_sources(bounced, setup)
        self._last = setup, shadow_maps, light
        return light

    def with_sources(self, bounced: Float[Array, "v 3"], setup: LightSetup) -> SurfaceLight:
        """Light on the vertices: bounces, the photo's light, and the shares of its sources that a set-up keeps."""
        photo, shares, kept = self.estimate.light, self.kept(setup.existing), None
        if shares.any():
            lux = jnp.asarray(setup.reference_lux * shares, jnp.float32)
            kept = jnp.einsum("sc,svc->vc", lux, photo.sources, precision="highest")
        return SurfaceLight(photo.illuminance, bounced, photo.transport.faces, self.emitters(setup), kept)

    def summary(self, estimate: Estimate) -> str:
        """Line on the sources of the photos, the belief in the estimate, and the remedy where that is wrong."""
        sources = self.sources
        names = [window.name for window in sources.windows] + [lamp.name for lamp in sources.lamps]
        origin = {"file": "named", "capture": "known of the capture", "found": "found in the pictures", "none": ""}
        lit = f"{', '.join(names)} ({origin[sources.origin]})" if names else "no window and no lamp was found"
        brightness, hue = (f"{100 * share:.0f} %" for share in (estimate.exponent, estimate.hue_exponent))
        assumed = "" if names else "it counts as coming from all around, and "
        shares = f"{brightness} of its estimated changes in brightness and {hue} in colour are taken out"
        fate = assumed + shares if estimate.exponent else f"it stays in the pictures: {estimate.reason}"
        remedy = f"; if {'other ' * bool(names)}windows or lamps lit the photos, name them with --photo-sources"
        return f"light of the photos: {lit}; {fate}{remedy if sources.origin != 'file' else ''}"

    def record(self) -> dict[str, Any]:
        """Entries of the photo's light in a run's record; flatness is by the exponent, the least if that is 0."""
        found = self.estimate
        flatness = found.flatness[EXPONENTS.index(found.exponent)] if found.exponent else min(found.flatness)
        return {
            "sources": list(found.names),
            "origin": self.sources.origin,
            "exponent": found.exponent,
            "hue_exponent": found.hue_exponent,
            "flatness": round(flatness, 3),
        }

    def unknown(self, existing: Mapping[str, Any]) -> str | None:
        """Message about names that are no source of these photos; None if all are."""
        names = self.estimate.names
        wrong = [f"{name!r}{did_you_mean(name, names)}" for name in existing if name not in names]
        return f"the photos have no source {', '.join(wrong)}; there are {', '.join(names)}" if wrong else None

    def kept(self, existing: Mapping[str, Sequence[float]]) -> Float[np.ndarray, "s 3"]:
        """Remaining factor of each source of the photo."""
        if unknown := self.unknown(existing):
            raise InputError(f"existing: {unknown}")
        return np.array([existing.get(name, (0.0, 0.0, 0.0)) for name in self.estimate.names])

    def emitters(self, setup: LightSetup) -> Emitters | None:
        """Panes and lamps with their radiance under new lights; None if there are none that are believed."""
        windows = self.sources.windows
        formed = [number for number, lamp in enumerate(self.sources.lamps) if lamp.radius > 0]
        lamps = [self.sources.lamps[number] for number in formed]
        believed = self.estimate.exponent > 0 or self.sources.origin == "file"
        if not (windows or lamps) or not believed:
            return None
        panes = np.array([(w.center, w.right, w.up) for w in windows]).reshape(-1, 3, 3)
        bulbs = np.array([(*lamp.position, lamp.radius) for lamp in lamps]).reshape(-1, 4)
        sent = radiant_filter(setup.lights, panes, bulbs, float(setup.reference_lux))
        rows = [*range(len(windows)), *(len(windows) + number for number in formed)]  # as the sources are
        kept = self.kept(setup.existing)[rows]
        spans, recess, means = (jax.device_put(self._stored[1][name]) for name in PANES)
        own, round_, light, left = (jax.device_put(np.asarray(a, np.float32)) for a in (panes, bulbs, sent, kept))
        return Emitters(own, Bars(spans, recess), round_, light, left, self.estimate.light.mean, means)

    @functools.cached_property
    def _key(self) -> str:
        """Key of all inputs of the sources and the light, made without reading a frame."""
        capture = self._capture
        anchors = sorted(
            (name, sorted((key, np.asarray(value).tolist()) for key, value in place.items()))
            for name, place in capture.anchors.items()
        )
        known = [repr(np.asarray(capture.up).tolist()), repr(anchors), _content(self._sources_file)]
        return digest([capture.fingerprint, str(self._longest), self._caster.arrays.key, *known])

    @property
    def _file(self) -> Path:
        return cache_folder() / f"photo-light-v{VERSION}-{self._key}.npz"

    @functools.cached_property
    def _stored(self) -> _Stored:
        """Estimate, and the panes of the windows."""
        return self._read_or_made() if self._begun is None else self._begun.result()

    def _read_or_made(self) -> _Stored:
        caster, up = self._caster, np.asarray(self._capture.up, np.float64)

        def made() -> Arrays:
            # Rays through windows that are known need no frame: these may still be rendered.
            known = hinted_windows(self._capture.anchors, up) if self._sources_file is None else ()
            rays = trace_scan(caster, up, known, self._progress) if known else None
            sources, frames = self.sources, self._frames
            with ThreadPoolExecutor(1, thread_name_prefix="panes") as pool:
                panes = pool.submit(pane_arrays, sources.windows, frames, caster)
                arrays = estimate_arrays(
                    caster, frames, up, sources, self._progress, rays=rays, expect=self._expect
                )
                return {**arrays, **panes.result()}

        found = cached_arrays(
            self._file, lambda arrays: (read_estimate(caster, arrays), {name: arrays[name] for name in PANES}), made
        )
        forget_small_frames(self._capture)  # where the estimate was kept, nobody has asked for them
        return found

    @functools.cached_property
    def _frames(self) -> list[Frame]:
        """Frames spread over the capture, no larger than needed."""

        def read(index: int) -> Frame | None:
            try:
                return shrink(small_frame(self._capture, index), self._longest)
            except InputError as error:  # told in full when it is its turn to be relit
                _log.info("the photo's light is estimated without frame %d: %s", index, error)
                return None

        chosen = spread(range(len(self._capture)), FRAME_COUNT)
        frames = prefetch(read, chosen, depth=1)  # in order, as videos are read
        return [frame for frame in frames if frame is not None] or [
            shrink(small_frame(self._capture, 0), self._longest)
        ]

    @property
    def _longest(self) -> int:
        """Longer side of these frames. Larger ones are shrunk to it, as what is found differs by size.

        Smaller ones stay as they are: what is enlarged shows false windows.
        """
        return min(SMALL_WIDTH, max(self._size or (SMALL_WIDTH,)))


def _content(file: Path | None) -> str:
    """Hash of a file's content, or its name where it cannot be read, an error that comes with the reading."""
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest() if file is not None else ""
    except OSError:
        return str(file)
