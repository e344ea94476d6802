"""Textures of the built-in room: square, repeating images of linear albedo. Rows run along v, columns along u."""

import numpy as np
from jaxtyping import Float

from hyjax.synthetic.noise import noise, pixel_centres

Image = Float[np.ndarray, "n n 3"]


def mix(a: tuple[float, ...], b: tuple[float, ...], amount: Float[np.ndarray, "n n"]) -> Image:
    """Mixture of colour `a` and colour `b`."""
    t = np.clip(amount, 0.0, 1.0)[..., None].astype(np.float32)
    return np.asarray(a, np.float32) * (1 - t) + np.asarray(b, np.float32) * t


def _grey(value: Float[np.ndarray, "n n"]) -> Image:
    return np.repeat(value[..., None], 3, axis=-1)


def plain(n: int, rng: np.random.Generator) -> Image:
    """Plain white, coloured by the tint alone."""
    del rng
    return np.ones((n, n, 3), np.float32)


def paint(n: int, rng: np.random.Generator) -> Image:
    """A rolled wall: faint clouds and orange-peel grain."""
    return _grey(0.965 + 0.007 * noise(n, n / 14, n / 14, rng) + 0.007 * noise(n, 1.2, 1.2, rng))


def _grain(n: int, scale: float, rng: np.random.Generator) -> Float[np.ndarray, "n n"]:
    """Wood grain along u in about [0, 1]; `scale` is pixels per metre."""
    fibre = noise(n, 0.06 * scale, 0.0012 * scale, rng)
    bands = noise(n, 0.35 * scale, 0.010 * scale, rng)
    clouds = noise(n, 0.25 * scale, 0.05 * scale, rng)
    rings = np.sin(9.0 * bands + 2.0 * clouds)
    return 0.5 + 0.10 * fibre + 0.13 * rings + 0.10 * clouds


def planks(n: int, rng: np.random.Generator) -> Image:
    """An oak floor: 40 rows of boards running along u, each with its own tone and piece of grain."""
    rows, boards = 40, 4
    grain = _grain(n, n / 5.2, rng)
    row = np.arange(n) * rows // n
    joints = np.sort((np.arange(boards) + rng.uniform(0.1, 0.9, (rows, boards))) / boards, axis=1)
    joints = (joints + rng.uniform(0, 1, (rows, 1))) % 1.0
    joints.sort(axis=1)
    column = np.stack([np.searchsorted(j * n, np.arange(n) + 0.5) % boards for j in joints])
    board = row[:, None] * boards + column[row]
    count = rows * boards
    shift_u, shift_v = rng.integers(0, n, (2, count))
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    value = grain.ravel().take((i + shift_v.take(board)) % n * n + (j + shift_u.take(board)) % n)
    value = value + rng.normal(0, 0.12, count).astype(np.float32).take(board)
    image = mix((0.20, 0.115, 0.058), (0.52, 0.355, 0.21), value)
    image *= (1 + 0.05 * rng.standard_normal((count, 3)) * (1, 0.3, -0.8)).astype(np.float32).take(board, axis=0)
    gap = np.minimum(np.arange(n) * rows % n, (-np.arange(n) - 1) * rows % n) < rows * 0.6
    across = column[row] != np.roll(column[row], 1, axis=1)
    image[gap] *= 0.5
    image[across] *= 0.45
    return image


def wood(n: int, rng: np.random.Generator) -> Image:
    """Furniture wood, light, to be darkened by its tint."""
    return mix((0.50, 0.36, 0.25), (0.98, 0.86, 0.70), _grain(n, n / 1.6, rng) * 1.3 - 0.1)


def fabric(n: int, rng: np.random.Generator) -> Image:
    """Upholstery: a fine crossed weave with slubs."""
    u, v = pixel_centres(n)
    threads = np.sin(2 * np.pi * 90 * u) * np.sin(2 * np.pi * 90 * v)
    slubs = noise(n, 7, 0.8, rng) + noise(n, 0.8, 7, rng)
    return _grey(0.88 + 0.05 * threads + 0.03 * slubs)


def weave(n: int, rng: np.random.Generator) -> Image:
    """Linen, finer and paler than upholstery."""
    return _grey(0.93 + 0.015 * (noise(n, 14, 0.7, rng) + noise(n, 0.7, 14, rng)))


def stripes(n: int, rng: np.random.Generator) -> Image:
    """A cushion cloth with woven stripes."""
    u, v = pixel_centres(n)
    wide = np.clip(6 * np.sin(2 * np.pi * 7 * v), -1, 1) * 0.5 + 0.5
    thin = np.clip(8 * np.sin(2 * np.pi * 21 * v) - 6.5, 0, 1)
    image = mix((0.86, 0.83, 0.76), (0.36, 0.42, 0.47), 0.85 * wide)
    image = image * (1 - 0.5 * thin[..., None])
    return image * _grey(0.95 + 0.05 * noise(n, 5, 0.7, rng) + 0.0 * u)


def rug(n: int, rng: np.random.Generator) -> Image:
    """A woven rug of 2.4 × 1.7 m: borders, a field of stepped diamonds, yarn noise."""
    u, v = pixel_centres(n)
    x, y = u * 2.4, v * 2.4
    edge = np.minimum(np.minimum(x, 2.4 - x), np.minimum(y, 1.7 - y))
    step = 0.02
    xs, ys = np.floor((x - 1.2) / step + 0.5) * step, np.floor((y - 0.85) / step + 0.5) * step
    lattice = (np.abs((xs / 0.48) % 1 - 0.5) + np.abs((ys / 0.48) % 1 - 0.5)) * 2
    cream, red, blue, dark = (0.62, 0.54, 0.42), (0.36, 0.115, 0.085), (0.085, 0.14, 0.22), (0.05, 0.055, 0.08)
    image = mix(red, red, lattice)
    for low, high, color in ((0.0, 0.25, cream), (0.35, 0.5, blue), (0.9, 1.1, cream), (1.3, 1.45, blue),
                              (1.75, 2.01, dark)):  # fmt: skip
        image[(lattice >= low) & (lattice < high)] = color
    teeth = np.abs(((x + y) / 0.12) % 1 - 0.5) * 2
    for low, high, color in ((0.0, 0.03, dark), (0.03, 0.17, blue), (0.17, 0.19, cream), (0.19, 0.23, red),
                              (0.23, 0.245, cream)):  # fmt: skip
        image[(edge >= low) & (edge < high)] = color
    image[(edge >= 0.06) & (edge < 0.14) & (teeth > 0.55)] = cream
    yarn = 1 + 0.10 * noise(n, 2.5, 0.6, rng) + 0.07 * noise(n, 40, 3, rng) + 0.05 * noise(n, 50, 50, rng)
    soft = sum(np.roll(image, k, axis=a) for k in (-1, 0, 1) for a in (0, 1)) / 6
    return soft * np.clip(yarn, 0.4, 1.5)[..., None]


def books(n: int, rng: np.random.Generator) -> Image:
    """Sixteen spines side by side (4 cm each along u, v is height): title blocks and bands over a plain cover."""
    image = np.full((n, n, 3), 0.8, np.float32)
    u, v = pixel_centres(n)
    height = v * 0.64
    for k in range(16):
        lane = (u >= k / 16) & (u < (k + 1) / 16)
        inner = np.abs((u * 16) % 1 - 0.5) < 0.26
        light = rng.choice([0.25, 1.0])
        for _ in range(rng.integers(1, 4)):
            at, thick = rng.uniform(0.015, 0.2), rng.uniform(0.002, 0.008)
            image[lane & (np.abs(height - at) < thick)] = light
        at, length = rng.uniform(0.07, 0.12), rng.uniform(0.03, 0.07)
        letters = noise(n, 1.0, 1.6, rng) > 0.1
        image[lane & inner & (np.abs(height - at) < length) & letters] = light
    return image * _grey(0.97 + 0.02 * noise(n, 3, 3, rng))


def leaf(n: int, rng: np.random.Generator) -> Image:
    """Green leaves with paler blotches."""
    return mix((0.035, 0.10, 0.025), (0.13, 0.27, 0.07), 0.45 + 0.2 * noise(n, 12, 30, rng))


def soil(n: int, rng: np.random.Generator) -> Image:
    """Potting earth."""
    return mix((0.02, 0.013, 0.008), (0.12, 0.08, 0.05), 0.4 + 0.3 * noise(n, 2, 2, rng))


def picture(n: int, rng: np.random.Generator) -> Image:
    """A painting: hazy hills under an evening sky, the left half another version than the right."""
    u, v = pixel_centres(n)
    image = mix((0.85, 0.55, 0.33), (0.25, 0.42, 0.58), v * 1.3 - 0.15 + 0.06 * noise(n, 40, 8, rng))
    sun = np.exp(-((((u - 0.62) / 0.05) ** 2 + ((v - 0.56) / 0.05) ** 2) ** 2))
    image = image + sun[..., None] * (np.array([0.95, 0.85, 0.6], np.float32) - image)
    ridge_noise = noise(n, 22, 22, rng)
    for k, level in enumerate((0.52, 0.43, 0.33, 0.22, 0.12)):
        ridge = level + 0.05 * ridge_noise[k * n // 8] + 0.03 * np.sin(2 * np.pi * (u[0] * (k + 1) + 0.3 * k))
        shade = np.array([0.34 - 0.06 * k, 0.38 - 0.06 * k, 0.42 - 0.075 * k], np.float32)
        hill = np.clip((ridge[None, :] - v) * n / 2, 0, 1)[..., None]
        image = image * (1 - hill) + shade * hill
    return image * (1 + 0.05 * _grey(noise(n, 3, 1, rng)))


def pages(n: int, rng: np.random.Generator) -> Image:
    """The edges of a block of paper: thin lines across u."""
    return mix((0.62, 0.56, 0.45), (0.88, 0.84, 0.74), 0.6 + 0.3 * noise(n, 0.5, 20, rng))
