"""Shadow maps of the last lights, those of a light that only its strength or colour has changed included."""

import threading
from collections.abc import Callable, Hashable, Sequence

from hyjax.light.kinds import Light
from hyjax.light.setup import geometry_key
from hyjax.light.shadow_map import ShadowMap

Maps = tuple[ShadowMap | None, ...]
Cast = Callable[[Sequence[Light]], Maps]


class KeptMaps:
    """Shadow maps of the last sets of lights.

    Attributes:
        most: sets that are kept, of the two kinds of occluders, say.
    """

    def __init__(self) -> None:
        self.most = 2
        self._sets: list[tuple[Hashable, tuple[Hashable, ...], Maps]] = []
        self._lock = threading.Lock()

    def of(self, kind: Hashable, lights: Sequence[Light], cast: Cast) -> Maps:
        """Maps of lights: those of the last sets by their geometry, the others cast.

        Args:
            kind: of the maps; those of other kinds are not taken.
        """
        keys = tuple(geometry_key(light) for light in lights)
        with self._lock:
            for place, (own, earlier, maps) in enumerate(self._sets):
                if (own, earlier) == (kind, keys):
                    self._sets.append(self._sets.pop(place))  # the last used are kept
                    return maps
            sets = [zip(earlier, maps) for own, earlier, maps in self._sets if own == kind]
        known = dict(pair for pairs in sets for pair in pairs)
        new = {key: light for light, key in zip(lights, keys) if key not in known}
        made = dict(zip(new, cast(list(new.values())), strict=True)) if new else {}
        maps = tuple((known | made)[key] for key in keys)
        with self._lock:
            self._sets = [*self._sets, (kind, keys, maps)][-self.most :]
        return maps
