"""Endless stream of training crops: the same for the same seed, from any position."""

import threading
from collections.abc import Sequence
from typing import Any

import grain
import numpy as np

from hyjax.pairs.augmentation import Crop, Packed, random_crop
from hyjax.pairs.depth_pairs import DepthPairs
from hyjax.util.errors import InputError
from hyjax.util.files import digest
from hyjax.util.images import to_bytes

GENERATED_COUNT = 1 << 20
"""Number of pairs from which a source generates them: they are read in their order, in which neighbours share a
room, and not kept."""
STREAM_CROPS = 1 << 40
"""Number of crops in a stream: in practice it never ends."""
MEMORY_BYTES = 4 << 30
"""Memory of kept decoded pairs, in bytes."""


class PairLoader:
    """Endless iterator over batches of crops.

    Crop number i of the stream follows from the seed and i alone, hence from neither threads nor hosts.
    Every source is gone through in a shuffled order, again and again, and sources take turns by weight.

    Args:
        size: side of the crops in pixels.
        seed: of order, crops and colours.
        weights: how often each source is drawn from, in any unit; equally often if not given.
        shard: (index, count) of this host: it gets every count-th batch.
        augment: whether crops are rescaled, mirrored and recoloured, or only cut out.
        threads: that make batches ahead of time; 0 makes them on demand.
    """

    def __init__(
        self,
        sources: Sequence[DepthPairs],
        *,
        size: int,
        batch: int,
        seed: int = 0,
        weights: Sequence[float] | None = None,
        shard: tuple[int, int] = (0, 1),
        augment: bool = True,
        threads: int = 2,
    ) -> None:
        weights = [1.0] * len(sources) if weights is None else list(weights)
        if not sources:
            raise InputError("pairs: no source given; name at least one")
        if len(weights) != len(sources) or not all(np.isfinite(w) and w > 0 for w in weights):
            raise InputError(f"weights: need one above 0 for each of {len(sources)} sources, got {weights}")
        if threads < 0:
            raise InputError(f"threads: must be at least 0, got {threads}")
        if size < 1 or batch < 1:
            raise InputError(f"size and batch: must be at least 1, got {size} and {batch}")
        if not 0 <= seed < 2**32:
            raise InputError(f"seed: must lie in [0, 2^32), got {seed}")
        if not 0 <= shard[0] < shard[1]:
            raise InputError(f"shard: index {shard[0]} must lie in [0, {shard[1]})")
        memory = _PairMemory(sources)
        streams = []
        for number, source in enumerate(sources):
            stream = grain.MapDataset.range(len(source))
            if len(source) < GENERATED_COUNT:
                stream = stream.shuffle(seed=(seed + number) % 2**32).repeat()
            streams.append(stream.map(lambda index, number=number: memory(number, index)))

        def cut(pair: Packed, rng: np.random.Generator) -> Crop:
            return random_crop(pair, size, rng, augment)

        crops = grain.MapDataset.mix(streams, weights)[:STREAM_CROPS].random_map(cut, seed=seed)
        # Batches are dealt to the hosts whole: dealt crop by crop, a host could get all of one source.
        dealt = crops.batch(batch)[shard[0] :: shard[1]]
        ahead = grain.ReadOptions(num_threads=threads, prefetch_buffer_size=2 * threads)
        self._batches = iter(dealt.to_iter_dataset(ahead))
        settings = f"{size} {batch} {seed} {weights} {shard[1]} {augment}"
        self._stream = digest([settings, *(source.fingerprint for source in sources)])

    def __iter__(self) -> "PairLoader":
        return self

    def __next__(self) -> Crop:
        return Crop(*next(self._batches))

    def state(self) -> dict[str, Any]:
        """Position in the stream, in JSON's types; the same on all hosts in step."""
        return {"stream": self._stream, "position": self._batches.get_state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a position."""
        if state.get("stream") != self._stream:
            raise InputError("pairs: cannot resume, the sources or the settings of their crops have changed")
        self._batches.set_state(state["position"])


class _PairMemory:
    """Cache of pairs by source and index, with no eviction at `MEMORY_BYTES` bytes: every epoch needs all pairs."""

    def __init__(self, sources: Sequence[DepthPairs]) -> None:
        self._sources, self._pairs, self._free = sources, dict[tuple[int, int], Packed](), MEMORY_BYTES
        self._lock = threading.Lock()

    def __call__(self, number: int, index: int) -> Packed:
        source = self._sources[number]
        index %= len(source)
        found = self._pairs.get((number, index))
        if found is not None:
            return found
        pair = source[index]
        image = to_bytes(pair.image)
        normal = None if pair.normal is None else np.round(pair.normal * 127).astype(np.int8)
        packed = Packed(image, np.where(pair.valid, pair.depth, np.float32(0)), normal, pair.unit == "disparity")
        with self._lock:
            if len(source) < GENERATED_COUNT and packed.nbytes <= self._free and (number, index) not in self._pairs:
                self._pairs[number, index] = packed
                self._free -= packed.nbytes
        return packed
