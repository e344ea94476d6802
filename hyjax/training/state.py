"""State of the network, its optimiser, and the compiled update from one state to the next."""

import dataclasses
import functools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import nnx
from jax.sharding import AxisType, NamedSharding, PartitionSpec
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from hyjax.guide import GuideNetwork, load_weights, normalise
from hyjax.guide.weights import kappa_of
from hyjax.training.objective import Losses, batch_losses, total
from hyjax.training.settings import TrainSettings
from hyjax.training.targets import Sample
from hyjax.util.errors import InputError

Tree = Any


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class TrainState:
    """State of a training run between two updates.

    Attributes:
        weights: `network`, its parameters as nested dictionaries, and `log_kappa`, of the learned κ.
        statistics: running statistics of its batch norms, likewise.
    """

    weights: Tree
    statistics: Tree
    optimizer: Tree
    iteration: Int[Array, ""]


class Progress(NamedTuple):
    """Outcome of an update: its losses, gradient and κ.

    Attributes:
        loss: the weighted sum before the update.
        gradient: global norm of its gradient, before clipping.
        kappa: the learned κ before the update.
        sound: whether all of these and the new weights are finite.
    """

    loss: Float[Array, ""]
    parts: Losses
    gradient: Float[Array, ""]
    kappa: Float[Array, ""]
    sound: Bool[Array, ""]


class Updater:
    """Updater of one network under one set of settings, with batches spread over all devices of all hosts.

    Args:
        started: whether a state will be restored, so that there is no need of weights to start from.
    """

    def __init__(self, settings: TrainSettings, started: bool = False) -> None:
        devices = jax.device_count()
        if settings.batch % devices:
            raise InputError(f"batch: {settings.batch} crops cannot be divided among {devices} devices")
        self.settings = settings
        network = GuideNetwork(settings.encoder, settings.features, rngs=nnx.Rngs(settings.seed))
        self._log_kappa = 0.0
        if settings.start and not started:
            self._log_kappa = math.log(kappa_of(load_weights(settings.start, network), settings.start))
        network.train()
        self._graph: Any = nnx.graphdef(network)
        self._weights = nnx.to_pure_dict(nnx.state(network, nnx.Param))
        self._statistics = nnx.to_pure_dict(nnx.state(network, nnx.Not(nnx.Param)))
        network.eval()
        self._still: Any = nnx.graphdef(network)
        rate = optax.exponential_decay(settings.learning_rate, settings.decay_every, settings.decay, staircase=True)
        self._optimizer = optax.chain(optax.clip_by_global_norm(settings.clip), optax.adam(rate))
        mesh = jax.make_mesh((devices,), ("batch",), axis_types=(AxisType.Auto,))
        self._everywhere = NamedSharding(mesh, PartitionSpec())
        self._spread = NamedSharding(mesh, PartitionSpec("batch"))
        self._update: Any = jax.jit(self._updated, donate_argnums=0)
        self._features = jax.jit(lambda state, images: self.network(state)(normalise(images)))

    def initial(self) -> TrainState:
        """State before the first update."""
        weights = {"network": self._weights, "log_kappa": jnp.asarray(self._log_kappa, jnp.float32)}
        state = TrainState(weights, self._statistics, self._optimizer.init(weights), jnp.zeros((), jnp.int32))
        return self.placed(state)

    def placed(self, state: TrainState) -> TrainState:
        """Copy the state to every device, in memory of its own."""
        return jax.tree.map(lambda x: jax.device_put(jnp.array(x), self._everywhere), state)

    def spread(self, local: Sample) -> Sample:
        """Assemble the batch over all devices from this host's part."""
        return Sample(*(jax.make_array_from_process_local_data(self._spread, np.asarray(x)) for x in local))

    def update(self, state: TrainState, batch: Sample) -> tuple[TrainState, Progress]:
        """Update the state, which is donated. An unsound update changes nothing."""
        return self._update(state, batch)

    def features(self, state: TrainState, images: Float[ArrayLike, "b h w 3"]) -> Float[Array, "b h w f"]:
        """Guides of display-encoded pictures, with the running statistics."""
        return self._features(state, jnp.asarray(images))

    def prepare(self, state: TrainState, batch: Sample) -> int:
        """Compile the update. Returns the additional memory that it will need, in bytes."""
        self._update = self._update.lower(state, batch).compile()
        analysis = self._update.memory_analysis()
        return int(analysis.temp_size_in_bytes + analysis.output_size_in_bytes)

    def network(self, state: TrainState) -> GuideNetwork:
        """Network of a state, ready for inference."""
        return nnx.merge(self._still, state.weights["network"], state.statistics)

    def _updated(self, state: TrainState, batch: Sample) -> tuple[TrainState, Progress]:
        settings = self.settings
        # All that is random follows from seed and iteration, so that a resumed run repeats it.
        key = jax.random.fold_in(jax.random.key(settings.seed), state.iteration)
        factor_key, key = jax.random.split(key)
        factor_index = jax.random.randint(factor_key, (), 0, len(settings.factors))

        def loss(weights: Tree) -> tuple[Array, tuple[Losses, Tree]]:
            network = nnx.merge(self._graph, weights["network"], state.statistics)
            features = network(normalise(batch.image))
            statistics = nnx.to_pure_dict(nnx.state(network, nnx.Not(nnx.Param)))
            losses = batch_losses(features, weights["log_kappa"], batch, key, factor_index, settings)
            return total(losses, settings), (losses, statistics)

        (value, (losses, statistics)), gradient = jax.value_and_grad(loss, has_aux=True)(state.weights)
        updates, optimizer = self._optimizer.update(gradient, state.optimizer, state.weights)
        weights = optax.apply_updates(state.weights, updates)
        norm = optax.tree.norm(gradient)
        sound = functools.reduce(
            jnp.logical_and, [jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves((value, norm, weights, statistics))]
        )
        progress = Progress(value, losses, norm, jnp.exp(state.weights["log_kappa"]), sound)
        after = TrainState(weights, statistics, optimizer, state.iteration + 1)
        return jax.tree.map(lambda new, old: jnp.where(sound, new, old), after, state), progress
