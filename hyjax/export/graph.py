"""Function to export at a fixed size, with example inputs and the parity that a runtime must reach."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import export
from jaxtyping import Array, Float

from hyjax.core.cascade import cascade
from hyjax.core.refine import cascade_known
from hyjax.core.schedule import Schedule
from hyjax.export.settings import ExportSettings
from hyjax.export.unroll import fenced, unrolled
from hyjax.guide.choose import FrameGuide, open_guide
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError

CASCADE_TOLERANCE = 1e-4
NETWORK_TOLERANCE = 1e-3
SEED = 0
LARGEST_VALUE = 2.3
"""Largest value of the example filter."""

Named = dict[str, Float[np.ndarray, "..."]]
Run = Callable[[Named], Float[np.ndarray, "..."]]
"""A converted function: inputs by name → the output."""


@dataclasses.dataclass(frozen=True)
class Port:
    """Input or output of a function.

    Attributes:
        name: in the exported file.
        shape: height, width, channels.
        meaning: with the range of values, for the README.
    """

    name: str
    shape: tuple[int, ...]
    meaning: str


@dataclasses.dataclass(frozen=True)
class Graph:
    """Function of arrays at a fixed size.

    Attributes:
        name: of the function and of its file.
        function: from arrays, in the order of `inputs`, to one array.
        inputs: what it takes.
        output: what it gives.
        examples: an example of every input, by name.
        tolerance: largest difference allowed, relative to the range of the output's values.
        origin: what it was made from, in a line.
    """

    name: str
    function: Callable[..., Array]
    inputs: tuple[Port, ...]
    output: Port
    examples: Named
    tolerance: float
    origin: str

    @property
    def flat(self) -> Callable[..., Array]:
        """The function without loops and calls; its name is the graph's."""
        return self._named(unrolled(self.function))

    @property
    def flat_with_barriers(self) -> Callable[..., Array]:
        """`flat`, in which transpositions stay where they are: LiteRT's converter moves some to wrong places."""
        return self._named(fenced(unrolled(self.function), primitive="transpose"))

    @property
    def compact(self) -> Callable[..., Array]:
        """The function as JAX has it, with loops; its name is the graph's."""
        return self._named(self.function)

    @property
    def specs(self) -> list[jax.ShapeDtypeStruct]:
        """Shape and type of every input."""
        return [jax.ShapeDtypeStruct(port.shape, jnp.float32) for port in self.inputs]

    def reference(self) -> Float[np.ndarray, "..."]:
        """Output of the examples by JAX."""
        return np.asarray(jax.jit(self.function)(*(self.examples[port.name] for port in self.inputs)))

    def _named(self, function: Callable[..., Array]) -> Callable[..., Array]:
        def call(*inputs: Array) -> Array:
            return function(*inputs)

        call.__name__ = call.__qualname__ = self.name
        return call


@checked_arguments
def build_graph(settings: ExportSettings) -> Graph:
    """The function that the settings ask for."""
    guide = open_guide(settings.guide)
    if settings.what == "guide":
        return guide_graph(guide, settings.shape)
    known = settings.what == "cascade"
    return cascade_graph(settings.open_schedule(), guide, settings.shape, channels=settings.channels, known=known)


@checked_arguments
def cascade_graph(
    schedule: Schedule, guide: FrameGuide, shape: tuple[int, int], *, channels: int = 3, known: bool = True
) -> Graph:
    """The cascade of a fixed schedule.

    Args:
        schedule: becomes part of the function.
        guide: whose features the function takes.
        shape: height and width.
        channels: of the filter.
        known: whether it takes a confidence; see `cascade_known`.
    """
    examples = example_inputs(shape, channels)
    examples["guide"] = np.asarray(guide.features(jnp.asarray(examples.pop("display"))), np.float32)
    learned = f"features of the frame: guide {guide.name}"
    meaning = {
        "filter": "values >= 0 in linear light, the light to multiply with; not finite counts as unknown",
        "confidence": "in [0, 1]: how far the filter is trusted at a pixel; 0 where it is unknown",
        "guide": "display-encoded RGB in [0, 1], the frame" if guide.name == "rgb" else learned,
    }
    if not known:
        examples["filter"] = examples["filter"] * examples.pop("confidence")
        meaning["filter"] = "values >= 0 in linear light, all of them finite"
    ports = tuple(Port(name, examples[name].shape, text) for name, text in meaning.items() if name in examples)

    def repair(*inputs: Array) -> Array:
        if known:
            y, confidence, features = inputs
            return cascade_known(y, confidence, features, schedule)
        y, features = inputs
        return cascade(y, features, schedule)

    return Graph(
        name="cascade" if known else "plain_cascade",
        function=repair,
        inputs=ports,
        output=Port("repaired", (*shape, channels), "the repaired filter, in the same units"),
        examples=examples,
        tolerance=CASCADE_TOLERANCE,
        origin=" ".join(str(schedule).splitlines()[0].split()),
    )


@checked_arguments
def guide_graph(guide: FrameGuide, shape: tuple[int, int]) -> Graph:
    """The network that computes a guide."""
    picture = example_inputs(shape, 1)["display"]
    features = jax.eval_shape(guide.features, jnp.asarray(picture)).shape
    return Graph(
        name="guide",
        function=guide.features,
        inputs=(Port("display", picture.shape, "display-encoded RGB in [0, 1], the frame"),),
        output=Port("features", features, "the `guide` of a cascade, of which κ = 0.02 is a sensible sensitivity"),
        examples={"display": picture},
        tolerance=NETWORK_TOLERANCE,
        origin=f"guide {guide.name}, weights {guide.fingerprint}",
    )


@checked_arguments
def example_inputs(shape: tuple[int, int], channels: int) -> Named:
    """A frame of flat patches with noise, and a filter with holes: `display`, `filter` and `confidence`."""
    height, width = shape
    random = np.random.default_rng(SEED)
    patches = random.random((5, 7, 3 + channels))
    rows, columns = (np.arange(n) * m // n for n, m in ((height, 5), (width, 7)))
    patch = patches[rows[:, None], columns[None]]
    display = np.clip(patch[..., :3] + 0.03 * random.standard_normal((*shape, 3)), 0.0, 1.0)
    shift = max(1, width // 40)  # the filter's borders are not quite where the frame's are
    light = LARGEST_VALUE * np.roll(patch[..., 3:], shift, 1) * (0.9 + 0.1 * random.random((*shape, channels)))
    confidence = np.where(random.random((*shape, 1)) < 0.1, 0.5, 1.0)
    confidence[height // 3 : height // 2, width // 4 : width // 2] = 0.0
    return {
        "display": display.astype(np.float32),
        "filter": light.astype(np.float32),
        "confidence": confidence.astype(np.float32),
    }


def measure_parity(graph: Graph, run: Run) -> float:
    """Largest difference between a runtime and JAX on the examples, relative to the range of JAX's values."""
    expected, got = graph.reference(), np.asarray(run(graph.examples))
    if got.shape != expected.shape:
        raise InputError(f"export: the runtime gives {got.shape}, JAX {expected.shape}; nothing was written")
    if not np.isfinite(got).all():
        return float("inf")
    spread = float(expected.max() - expected.min())
    return float(np.abs(got - expected).max()) / (spread or 1.0)


def check_parity(graph: Graph, run: Run, target: str) -> float:
    """`measure_parity`, if it is small enough."""
    parity = measure_parity(graph, run)
    if not parity <= graph.tolerance:
        raise InputError(
            f"export: {graph.name} by {target} differs from JAX by {parity:.2g} of the value range, more than "
            f"{graph.tolerance:g}; nothing was written"
        )
    return parity


def lower(graph: Graph, function: Callable[..., Array], *platforms: str) -> export.Exported:
    """One of the graph's functions for these platforms, by `jax.export`."""
    return export.export(jax.jit(function), platforms=platforms)(*graph.specs)


def lower_text(graph: Graph, function: Callable[..., Array]) -> str:
    """One of the graph's functions as StableHLO of a CPU."""
    return lower(graph, function, "cpu").mlir_module()
