"""The stream of crops: the same for the same seed wherever it is taken up, aligned, masked, and whole."""

import json
import threading
from collections import Counter
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from hyjax.pairs import augmentation
from hyjax.pairs import loader as pair_loader
from hyjax.pairs.augmentation import LEAST_VALID, Crop, Packed, color_matrix, random_crop, recolored
from hyjax.pairs.depth_pairs import DepthPair, Unit, masked_pair
from hyjax.pairs.loader import PairLoader
from hyjax.util.errors import InputError

HEIGHT, WIDTH = 60, 80


class Numbered:
    """Pairs whose every pixel says which pair it is from and where it was.

    Depth is 1 + number + row/1000 + column/100000; colours are row and column; normals lean to the left.
    """

    def __init__(self, name: str, count: int, unit: Unit = "metres", first: int = 0, content: str = "") -> None:
        self.name, self.unit, self.fingerprint = name, unit, f"{name} {count} {content}"
        self._count, self._first = count, first
        self.read: Counter[int] = Counter()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> DepthPair:
        with self._lock:
            self.read[index] += 1
        return numbered(self._first + index, self.unit)


def numbered(number: int, unit: Unit = "metres") -> DepthPair:
    row, column = np.indices((HEIGHT, WIDTH))
    depth = 1 + number + row / 1000 + column / 100000
    image = np.stack([row / 255, column / 255, 0 * row], axis=-1)
    normal = np.broadcast_to([-0.6, 0.0, -0.8], image.shape)
    return masked_pair(f"{number}", image, depth, unit, where="numbered", normal=normal)


def packed(pair: DepthPair) -> Packed:
    return Packed(np.round(pair.image * 255).astype(np.uint8), pair.depth, None, pair.unit == "disparity")


def numbers(batch: Crop) -> list[int]:
    """Which pairs the crops are from."""
    return [int(depth.max()) - 1 for depth in batch.depth]


def take(loader: PairLoader, count: int) -> list[Crop]:
    return [next(loader) for _ in range(count)]


def equal(some: Sequence[Crop], others: Sequence[Crop]) -> bool:
    return len(some) == len(others) and all(
        np.array_equal(x, y) for a, b in zip(some, others) for x, y in zip(a, b)
    )


def loader(*sources: Numbered, **options: object) -> PairLoader:
    chosen: dict[str, object] = {"size": 32, "batch": 4, "seed": 5, "threads": 0} | options
    return PairLoader(list(sources) or [Numbered("a", 7), Numbered("b", 3)], **chosen)  # type: ignore[arg-type]


# ---- the stream ----


def test_batches_are_what_they_say() -> None:
    batch = next(loader(Numbered("a", 7), Numbered("b", 3, unit="disparity", first=100)))
    assert batch.image.shape == batch.normal.shape == (4, 32, 32, 3)
    assert batch.depth.shape == batch.valid.shape == (4, 32, 32)
    assert batch.image.dtype == batch.depth.dtype == batch.normal.dtype == np.float32
    assert batch.valid.dtype == batch.disparity.dtype == bool
    assert batch.image.min() >= 0 and batch.image.max() <= 1
    np.testing.assert_array_equal(batch.valid, batch.depth > 0)
    np.testing.assert_array_equal(batch.disparity, np.array(numbers(batch)) >= 100)
    assert set(batch.disparity.tolist()) == {True, False}, "a batch mixes its sources"


def test_seed_decides() -> None:
    assert equal(take(loader(), 6), take(loader(), 6))
    assert not equal(take(loader(), 6), take(loader(seed=6), 6))


def test_crops_are_drawn_anew_each_time() -> None:
    batches = take(loader(Numbered("a", 1), batch=1), 8)
    assert len({batch.depth.tobytes() for batch in batches}) == 8


@pytest.mark.parametrize("threads", [1, 3])
def test_threads_change_nothing(threads: int) -> None:
    assert equal(take(loader(threads=threads), 12), take(loader(), 12))


def test_every_pair_has_its_turn() -> None:
    drawn = [n for batch in take(loader(Numbered("a", 8)), 4) for n in numbers(batch)]
    assert sorted(drawn[:8]) == sorted(drawn[8:]) == list(range(8))
    assert drawn[:8] != drawn[8:], "in another order each time"


def test_weights() -> None:
    sources = Numbered("a", 5), Numbered("b", 5, first=100)
    drawn = [n for batch in take(loader(*sources, weights=[3, 1]), 20) for n in numbers(batch)]
    assert sum(n >= 100 for n in drawn) == 20


def test_hosts_deal_the_stream_among_themselves() -> None:
    whole = take(loader(), 9)
    dealt = [take(loader(shard=(index, 3)), 3) for index in range(3)]
    assert equal([dealt[i % 3][i // 3] for i in range(9)], whole)


@pytest.mark.parametrize("threads", [0, 2])
@settings(max_examples=6)
@given(before=st.integers(0, 7), after=st.integers(1, 5))
def test_taken_up_again_it_goes_on(threads: int, before: int, after: int) -> None:
    first = loader(threads=threads)
    take(first, before)
    position = json.loads(json.dumps(first.state()))
    expected = take(first, after)
    again = loader(threads=threads)
    take(again, 2)
    again.restore(position)
    assert equal(take(again, after), expected)


def test_hosts_share_a_position() -> None:
    """What one host saves, another goes on from."""
    hosts = [loader(shard=(index, 2)) for index in range(2)]
    for host in hosts:
        take(host, 3)
    assert hosts[0].state() == hosts[1].state()
    again = loader(shard=(1, 2))
    again.restore(hosts[0].state())
    assert equal(take(again, 2), take(hosts[1], 2))


@pytest.mark.parametrize(
    "change", [{"seed": 6}, {"size": 16}, {"batch": 2}, {"weights": [1, 2]}, {"augment": False}]
)
def test_another_stream_is_not_gone_on_with(change: dict[str, object]) -> None:
    with pytest.raises(InputError, match="cannot resume"):
        loader(**change).restore(loader().state())
    with pytest.raises(InputError, match="cannot resume"):
        loader(Numbered("a", 7), Numbered("b", 3, content="changed")).restore(loader().state())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size": 0}, "at least 1"),
        ({"batch": 0}, "at least 1"),
        ({"seed": -1}, "seed"),
        ({"weights": [1.0]}, "one above 0"),
        ({"weights": [1.0, 0.0]}, "one above 0"),
        ({"weights": [1.0, float("nan")]}, "one above 0"),
        ({"shard": (2, 2)}, "shard"),
        ({"threads": -1}, "threads"),
    ],
)
def test_numbers_out_of_range(options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        loader(**options)


def test_no_source() -> None:
    with pytest.raises(InputError, match="no source"):
        PairLoader([], size=8, batch=1)


class Damaged(Numbered):
    """No pair of it can be read."""

    def __getitem__(self, index: int) -> DepthPair:
        raise InputError("x.png: damaged or truncated picture")


@pytest.mark.parametrize("threads", [0, 2])
def test_a_damaged_pair_is_named(threads: int) -> None:
    with pytest.raises(InputError) as caught:
        next(loader(Damaged("a", 7), threads=threads))
    assert str(caught.value) == "x.png: damaged or truncated picture"


# ---- memory ----


def test_pairs_are_read_once() -> None:
    source = Numbered("a", 5)
    take(loader(source), 10)
    assert set(source.read.values()) == {1} and len(source.read) == 5


def test_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = take(loader(Numbered("a", 5)), 10)
    one = HEIGHT * WIDTH * (3 + 4 + 3)
    monkeypatch.setattr(pair_loader, "MEMORY_BYTES", 2 * one + 1)
    source = Numbered("a", 5)
    assert equal(take(loader(source), 10), expected)
    assert sorted(source.read.values()) == [1, 1, 8, 8, 8], "two are kept, the others read each time"


def test_endless_sources_are_read_in_order_and_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pair_loader, "GENERATED_COUNT", 50)
    source = Numbered("rooms", 50)
    drawn = [n for batch in take(loader(source), 5) for n in numbers(batch)]
    assert drawn == list(range(20)) and set(source.read.values()) == {1}


# ---- crops ----


def test_plain_crops_are_windows_of_the_pair() -> None:
    for batch in take(loader(Numbered("a", 5), augment=False), 5):
        for image, depth, normal in zip(batch.image, batch.depth, batch.normal):
            place = depth - np.floor(depth)
            row, column = (np.round(255 * image[..., c]) for c in (0, 1))
            np.testing.assert_allclose(place, row / 1000 + column / 100000, atol=2e-6)
            assert np.all(np.diff(row, axis=0) == 1) and np.all(np.diff(column, axis=1) == 1)
            np.testing.assert_allclose(normal, np.broadcast_to([-0.6, 0, -0.8], normal.shape), atol=0.01)


def test_picture_depth_and_normals_stay_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the scale and on whichever side: what the picture says of its place is what the depth says."""
    monkeypatch.setattr(augmentation, "recolored", lambda picture, rng: np.asarray(picture, np.float32) / 255)
    mirrored, scales, off = set(), [], []
    for batch in take(loader(Numbered("a", 5)), 20):
        for image, depth, normal in zip(batch.image, batch.depth, batch.normal):
            place = np.round(1e5 * (depth.astype(np.float64) - np.floor(depth)))
            row, column = place // 100, place % 100
            # Nearest against averaged: half a pixel of the pair, the rounding to 8 bits, and float32's.
            assert np.abs(row - 255 * image[..., 0]).max() <= 1.01
            assert np.abs(column - 255 * image[..., 1])[2:-2, 2:-2].max() <= 1.51
            off.append(
                [np.mean((row - 255 * image[..., 0])[2:-2]), np.mean((column - 255 * image[..., 1])[:, 2:-2])]
            )
            rightwards = column[0, -1] > column[0, 0]
            assert np.all(normal[..., 0] < -0.5 if rightwards else normal[..., 0] > 0.5)
            np.testing.assert_allclose(np.linalg.norm(normal, axis=-1), 1, atol=1e-5)
            mirrored.add(not rightwards)
            scales.append(32 / (1 + np.ptp(row)))
    assert np.abs(np.mean(off, axis=0)).max() < 0.05  # on average not shifted at all
    assert mirrored == {True, False}
    assert 0.65 < min(scales) < 0.8 and 1.25 < max(scales) < 1.5


@given(
    height=st.integers(1, 70),
    width=st.integers(1, 70),
    size=st.integers(1, 40),
    seed=st.integers(0, 2**32 - 1),
    augment=st.booleans(),
)
def test_any_pair_gives_a_crop(height: int, width: int, size: int, seed: int, augment: bool) -> None:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(1, 2, (height, width)).astype(np.float32) * (rng.random((height, width)) < 0.5)
    pair = Packed(rng.integers(0, 256, (height, width, 3)).astype(np.uint8), depth.astype(np.float32), None, False)
    crop = random_crop(pair, size, rng, augment)
    assert crop.image.shape == crop.normal.shape == (size, size, 3) and crop.depth.shape == (size, size)
    assert np.isfinite(crop.image).all() and crop.image.min() >= 0 and crop.image.max() <= 1
    assert np.isin(crop.depth, depth).all(), "depth is never averaged"
    assert not crop.normal.any()


def test_crops_of_holes_are_drawn_again() -> None:
    pair = packed(numbered(0))
    holed = pair._replace(depth=np.where(np.arange(WIDTH) < 45, 0, pair.depth).astype(np.float32))
    shares = [random_crop(holed, 32, np.random.default_rng(i), True).valid.mean() for i in range(100)]
    assert min(shares) > LEAST_VALID - 0.1 and np.min(shares) < 0.9
    lost = pair._replace(depth=np.zeros_like(pair.depth))
    lost.depth[30, 40] = 1
    random_crop(lost, 32, np.random.default_rng(0), True)  # the best there is


# ---- colours ----


def test_recolored_pictures_are_pictures() -> None:
    rng = np.random.default_rng(0)
    picture = Image.fromarray(rng.integers(0, 256, (40, 50, 3)).astype(np.uint8))
    seen = [recolored(picture, np.random.default_rng(seed)) for seed in range(60)]
    assert all(x.dtype == np.float32 and x.shape == (40, 50, 3) and 0 <= x.min() <= x.max() <= 1 for x in seen)
    assert np.array_equal(seen[3], recolored(picture, np.random.default_rng(3)))
    means = np.array([x.mean(axis=(0, 1)) for x in seen])
    assert np.ptp(means.mean(axis=1)) > 0.3, "exposure varies"
    assert np.ptp(means[:, 0] / means[:, 2]) > 0.3, "white balance varies"


def test_recoloring_moves_no_border() -> None:
    pixels = np.full((64, 64, 3), 60, np.uint8)
    pixels[:, 40:] = 160
    for seed in range(60):
        image = recolored(Image.fromarray(pixels), np.random.default_rng(seed))
        step = np.abs(np.diff(image.mean(axis=(0, 2))))
        assert abs(np.argmax(step) - 39) <= 1


def test_color_matrix() -> None:
    np.testing.assert_allclose(color_matrix(1.0, 0.0), np.eye(3), atol=1e-6)
    np.testing.assert_allclose(color_matrix(0.0, 1.0), np.full((3, 3), 1 / 3), atol=1e-6)
    np.testing.assert_allclose(color_matrix(1.0, 2 * np.pi / 3), np.eye(3)[[2, 0, 1]], atol=1e-6)
    np.testing.assert_allclose(color_matrix(1.7, 0.4) @ np.ones(3), np.ones(3), atol=1e-6)
