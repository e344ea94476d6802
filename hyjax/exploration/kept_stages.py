"""Results of a refinement's stages, kept as long as what they are made from stays."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from hyjax.light.light_edges import edge_correction
from hyjax.pipeline import refine_illuminance, refine_visibility
from hyjax.util.programs import run_kept

MOST_KEPT = 6
"""Number of results that are kept: three of a draft, of two configurations."""
FEW_NUMBERS = 1024
"""Most numbers of an array that is compared by its values: those of a schedule, not pictures."""


class KeptStages:
    """Runs the functions of `refine`: the shadow pass again only if what it is made from has changed.

    Args:
        draft: whether the cascade's light is kept, too, and the correction by light edges, though lights or choices
            of the light change.
    """

    def __init__(self, *, draft: bool = False) -> None:
        self._draft = draft
        self._cascades = (refine_illuminance, refine_visibility) if draft else (refine_visibility,)
        self._kept: list[tuple[Any, list[Any], Any]] = []

    def __call__(self, function: Callable[..., Any], *arrays: Any, **static: Any) -> Any:
        if function in self._cascades:
            shaded, *rest = arrays
            made_from = dataclasses.replace(shaded, colors=None), *rest  # no cascade takes colours
            return self._of(function, made_from, lambda: run_kept(function, *arrays, **static))
        if function is edge_correction and self._draft:
            view, _, weights = arrays
            return self._of(function, (view, weights), lambda: run_kept(function, *arrays, **static))
        return run_kept(function, *arrays, **static)

    def _of(self, function: Any, arrays: Any, make: Callable[[], Any]) -> Any:
        """Result of the same arrays as before, or a new one; those that were used longest ago go."""
        leaves, tree = jax.tree.flatten(arrays)
        for place, (own, earlier, result) in enumerate(self._kept):
            if own == (function, tree) and all(map(_same, leaves, earlier)):
                self._kept.append(self._kept.pop(place))
                return result
        result = make()
        self._kept = [*self._kept, ((function, tree), leaves, result)][-MOST_KEPT:]
        return result


def _same(a: Any, b: Any) -> bool:
    return a is b or (max(np.size(a), np.size(b)) <= FEW_NUMBERS and np.array_equal(a, b))
