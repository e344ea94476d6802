"""Random repeating patterns, as shares of three colours over a ground colour.

A pattern is an n × n × 3 picture of shares in [0, 1]. With a palette of four colours c0…c3 its albedo is
c0 + Σ share_k (c_k − c0), so that one pattern serves any number of colourings.
"""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from hyjax.synthetic.noise import noise, pixel_centres

Shares = Float[np.ndarray, "n n 3"]


def _shares(*layers: np.ndarray) -> Shares:
    n = len(layers[0])
    out = np.zeros((n, n, 3), np.float32)
    for k, layer in enumerate(layers):
        out[..., k] = np.clip(layer, 0, 1)
    return out


def _step(x: np.ndarray, n: int, rate: float = 1.0) -> np.ndarray:
    """Soft step over about a pixel; `x` changes by `rate` over the whole picture."""
    return np.clip(x * n / max(rate, 1e-6) + 0.5, 0, 1)


def plain(n: int, rng: np.random.Generator) -> Shares:
    """Plain surface with slight unevenness."""
    return _shares(0.03 * noise(n, n / 8, n / 8, rng) + 0.03)


def clouds(n: int, rng: np.random.Generator) -> Shares:
    """Stains, marbling or mottle: noise of several scales."""
    scale = n * rng.uniform(0.02, 0.15)
    field = noise(n, scale, scale, rng) + 0.5 * noise(n, scale / 3, scale / 3, rng)
    if rng.random() < 0.4:  # marble veins
        return _shares(np.exp(-((field / rng.uniform(0.06, 0.3)) ** 2)), 0.3 + 0.2 * noise(n, n / 6, n / 6, rng))
    sharp = rng.choice([0.25, 0.5, 2.0])
    return _shares(0.5 + sharp * field, 0.3 * noise(n, 2, 2, rng))


def grain(n: int, rng: np.random.Generator) -> Shares:
    """Wood along u."""
    fine, rings = rng.uniform(0.0015, 0.004) * n, rng.uniform(0.01, 0.03) * n
    bands = noise(n, 0.3 * n, rings, rng)
    figure = np.sin(rng.uniform(3, 11) * bands + 2 * noise(n, 0.2 * n, 0.05 * n, rng))
    fibre = noise(n, 0.05 * n, fine, rng)
    knots = noise(n, 0.03 * n, 0.015 * n, rng) > 3.1
    knots = gaussian_filter(knots.astype(np.float32), (0.006 * n, 0.012 * n), mode="wrap") * 2
    contrast = rng.uniform(0.2, 1.0)
    return _shares(0.5 + contrast * (0.2 * figure + 0.15 * fibre), knots, np.clip(0.1 * fibre - 0.1, 0, 1))


def planks(n: int, rng: np.random.Generator) -> Shares:
    """Boards along u, each with its own tone and piece of grain, with dark or no joints."""
    rows, boards = int(rng.choice([6, 8, 12, 16])), int(rng.integers(2, 5))
    wood = grain(n, rng)
    row = np.arange(n) * rows // n
    joints = np.sort(((np.arange(boards) + rng.uniform(0, 1, (rows, 1))) / boards) % 1, axis=1)
    column = np.stack([np.searchsorted(j * n, np.arange(n) + 0.5) % boards for j in joints])
    board = row[:, None] * boards + column[row]
    shift = rng.integers(0, n, (2, rows * boards))
    i, j = np.indices((n, n))
    tone = rng.normal(0, rng.uniform(0.05, 0.35), rows * boards).astype(np.float32)
    value = wood[(i + shift[0][board]) % n, (j + shift[1][board]) % n, 0] + tone[board]
    gap = np.minimum(np.arange(n) * rows % n, (-np.arange(n) - 1) * rows % n) < rows * 0.8
    joint = (column[row] != np.roll(column[row], 1, axis=1)) | gap[:, None]
    return _shares(value, joint * rng.choice([0.15, 0.6, 1.0]), 0.25 * (rng.random(rows * boards) < 0.2)[board])


def tiles(n: int, rng: np.random.Generator) -> Shares:
    """Tiles, bricks or parquet squares with joints; tones from even to a chessboard's."""
    across, down = int(rng.choice([2, 4, 8])), int(rng.choice([2, 4, 8, 16]))
    u, v = pixel_centres(n)
    y = v * down
    x = u * across + (np.floor(y) % 2) * rng.choice([0.0, 0.5])
    wide = rng.uniform(0.01, 0.05) * min(across, down)
    fx, fy = np.abs(x % 1 - 0.5), np.abs(y % 1 - 0.5)
    joint = (fx > 0.5 - wide * across / 16) | (fy > 0.5 - wide * down / 16)
    cell = (np.floor(x) % across + across * (np.floor(y) % down)).astype(int)
    kind = rng.integers(3)
    tone = rng.random(across * down) if kind == 0 else (np.arange(across * down) % across + np.arange(
        across * down) // across) % 2 if kind == 1 else rng.normal(0.2, 0.1, across * down)  # fmt: skip
    body = tone[cell] + rng.uniform(0, 0.2) * noise(n, n / 30, n / 30, rng)
    return _shares(body * ~joint, 0.15 * noise(n, 3, 3, rng) * ~joint, joint * 1.0)


def stones(n: int, rng: np.random.Generator) -> Shares:
    """Patches: stone floor, terrazzo, crackle, camouflage."""
    points = rng.random((int(rng.choice([12, 40, 150, 600])), 2)) * n
    i, j = np.indices((n, n)) + 0.5
    distance, nearest = cKDTree(points, boxsize=n).query(np.stack([i.ravel(), j.ravel()], 1), k=2)
    rim = ((distance[:, 1] - distance[:, 0]) < rng.uniform(0.5, 3) * n / 256).reshape(n, n)
    tone = rng.random((len(points), 2)) ** rng.choice([1, 4])
    a, b = tone[nearest[:, 0]].reshape(n, n, 2).transpose(2, 0, 1)
    return _shares(a, b * rng.integers(2), rim * float(rng.choice([0, 1])))


def stripes(n: int, rng: np.random.Generator) -> Shares:
    """Bands along u, of random widths, or ribs."""
    _, v = pixel_centres(n)
    count = int(rng.choice([2, 4, 8, 16]))
    edges = np.sort(rng.random(count))
    band = np.searchsorted(edges, v[:, 0]) % count
    color = rng.integers(0, 4, count)
    lines = np.stack([color[band] == k for k in (1, 2, 3)], -1).astype(np.float32)
    return np.broadcast_to(lines[:, None], (n, n, 3)).copy()


def checks(n: int, rng: np.random.Generator) -> Shares:
    """Gingham, tartan, windowpane: stripes both ways."""
    a, b = stripes(n, rng), stripes(n, rng)
    if rng.random() < 0.6:
        b = a
    out = (a + b.transpose(1, 0, 2)) / 2
    return out / np.maximum(out.sum(-1, keepdims=True), 1)


def dots(n: int, rng: np.random.Generator) -> Shares:
    """Spots on a lattice or strewn, rings and squares among them."""
    count, u, v = int(rng.choice([2, 4, 6, 8])), *pixel_centres(n)
    x, y = u * count, v * count
    shift = rng.uniform(-0.2, 0.2, (2, count * count)) * rng.integers(2)
    cell = (np.floor(x) + count * np.floor(y)).astype(int)
    x, y = x % 1 - 0.5 + shift[0][cell], y % 1 - 0.5 + shift[1][cell]
    far = np.hypot(x, y) if rng.random() < 0.6 else np.maximum(np.abs(x), np.abs(y))
    far = far if rng.random() < 0.7 else np.abs(x) + np.abs(y)
    radius = (rng.uniform(0.1, 0.3) * rng.uniform(0.6, 1.0, count * count))[cell]
    body = _step(radius - far, n, count)
    core = _step(radius * rng.choice([0.0, 0.5, 0.7]) - far, n, count)
    other = (rng.random(count * count) < 0.4)[cell]
    return _shares(body * ~other - core, body * other - core, core)


def zigzag(n: int, rng: np.random.Generator) -> Shares:
    """Chevrons, waves, herringbone."""
    u, v = pixel_centres(n)
    count, teeth = int(rng.choice([3, 6, 12])), int(rng.choice([1, 2, 4, 8]))
    wave = np.abs((u * teeth) % 1 - 0.5) * 2 if rng.random() < 0.6 else 0.5 + 0.5 * np.sin(2 * np.pi * teeth * u)
    phase = (v * count + wave * rng.uniform(0.3, 1.5)) % 1
    band = np.floor(phase * 3)
    return _shares(band == 1, (band == 2) * rng.integers(2))


def weave(n: int, rng: np.random.Generator) -> Shares:
    """Coarse cloth, knit, wicker or carpet loops."""
    u, v = pixel_centres(n)
    count = int(rng.choice([16, 32, 64]))
    x, y = u * count, v * count
    over = (np.floor(x) + np.floor(y)) % 2
    thread = np.where(over > 0, np.abs(np.sin(np.pi * x)), np.abs(np.sin(np.pi * y)))
    slubs = 0.15 * (noise(n, 8, 1, rng) + noise(n, 1, 8, rng))
    return _shares(1 - thread + slubs, over * 0.7 * rng.integers(2), 0.2 * noise(n, 2, 2, rng))


def gradient(n: int, rng: np.random.Generator) -> Shares:
    """Slow change from one colour to another."""
    u, v = pixel_centres(n)
    turn = rng.uniform(0, 2 * np.pi)
    ramp = 0.5 + 0.5 * np.sin(2 * np.pi * (rng.integers(0, 2) * u + v) + turn)
    return _shares(ramp, 0.15 * noise(n, n / 4, n / 4, rng))


def curves(n: int, rng: np.random.Generator) -> Shares:
    """Line drawings, scribbles, contour lines."""
    field = noise(n, n * rng.uniform(0.03, 0.12), n * rng.uniform(0.03, 0.12), rng)
    slope = np.hypot(*np.gradient(field)) + 1e-6
    bands = field * rng.uniform(1, 4)
    line = np.abs(bands - np.round(bands)) / (slope * rng.uniform(1, 4)) / np.maximum(1, n / 256)
    return _shares(np.clip(1.5 - line, 0, 1), (np.round(bands) % 2) * rng.choice([0, 0, 0.6]))


def leaves(n: int, rng: np.random.Generator) -> Shares:
    """Dead leaves: shaded shapes of all sizes that cover each other, the noise most like a photograph.

    Borders in it look like borders of objects. (Lee, Mumford, Huang: Occlusion Models for Natural Images, IJCV
    2001.)
    """
    out = np.zeros((n, n, 3), np.float32) + rng.random(3) * 0.5
    for radius in np.sort(0.03 * rng.random(160) ** -0.55)[::-1] * n:
        half = int(np.ceil(min(radius, 0.45 * n)))
        row, column = rng.integers(0, n, 2)
        turn, stretch = rng.uniform(0, np.pi), rng.uniform(0.4, 1)
        y, x = np.mgrid[-half : half + 1, -half : half + 1] / half
        c, s = np.cos(turn), np.sin(turn)
        x, y = c * x - s * y, (s * x + c * y) / stretch
        far = np.hypot(x, y) if rng.random() < 0.6 else 1.3 * np.maximum(np.abs(x), np.abs(y))
        i, j = np.nonzero(far < 1)
        shade = 1 + rng.uniform(-0.5, 0.5) * x[i, j] + rng.uniform(-0.3, 0.3) * y[i, j]
        out[(row + i) % n, (column + j) % n] = rng.random(3) * shade[:, None]
    soft = gaussian_filter(out, (rng.uniform(0.4, 1.2),) * 2 + (0,), mode="wrap")
    return np.clip(soft + 0.06 * noise(n, 1.5, 1.5, rng)[..., None], 0, 1)


def text(n: int, rng: np.random.Generator) -> Shares:
    """A printed page: words of strokes in lines, a headline, perhaps a figure."""
    page = np.zeros((n, n, 3), np.float32)
    margin, y = int(0.06 * n), int(rng.uniform(0.05, 0.15) * n)
    while y < 0.92 * n:
        tall = int(n * (rng.uniform(0.04, 0.11) if rng.random() < 0.15 else rng.uniform(0.015, 0.03)))
        if rng.random() < 0.08:
            high, wide = int(rng.uniform(0.1, 0.3) * n), int(rng.uniform(0.3, 0.8) * n)
            page[y : y + high, margin : margin + wide] = leaves(64, rng)[
                np.arange(min(high, n - y))[:, None] * 64 // high, np.arange(wide) * 64 // wide
            ]
            y += high + tall
            continue
        _line(page, margin, y, tall, int(rng.uniform(0.5, 0.95) * n), int(rng.integers(0, 2)), rng)
        y += int(tall * rng.uniform(1.3, 2.0)) + 1
    return page


def _line(
    page: Shares, x: int, y: int, tall: int, end: int, color: int, rng: np.random.Generator, word: int = 5
) -> None:
    """Letters of two or three strokes each, from column `x` to `end`."""
    pen = max(1, tall // 6)
    while x < end - tall:
        if rng.random() < 1 / (word + 1):
            x += tall // 2
        wide = max(2, int(tall * rng.uniform(0.4, 0.75)))
        rise = 0 if rng.random() < 0.4 else tall // 3
        for _ in range(int(rng.integers(2, 4))):
            if rng.random() < 0.5:
                at = x + int(rng.integers(0, max(1, wide - pen)))
                page[y + rise : y + tall, at : at + pen, color] = 1
            else:
                at = y + rise + int(rng.integers(0, max(1, tall - rise - pen)))
                page[at : at + pen, x : x + wide, color] = 1
        x += wide + pen


def pack(n: int, rng: np.random.Generator) -> Shares:
    """The side of a carton: blocks of colour, a swoosh, a picture, big letters and small print, a bar code."""
    out = np.zeros((n, n, 3), np.float32)
    u, v = pixel_centres(n)
    for _ in range(int(rng.integers(1, 4))):
        edge = rng.uniform(0.2, 0.8) + rng.uniform(0, 0.15) * np.sin(2 * np.pi * (u if rng.random() < 0.5 else v))
        out[(v if rng.random() < 0.6 else u) < edge] = np.eye(4, 3, -1)[rng.integers(4)] * rng.uniform(0.5, 1)
    for _ in range(int(rng.integers(0, 4))):
        x, y = u - rng.random(), v - rng.random()
        out[np.hypot(x, y * rng.uniform(0.5, 2)) < rng.uniform(0.04, 0.25)] = np.eye(4, 3, -1)[rng.integers(4)]
    if rng.random() < 0.7:
        side = int(rng.uniform(0.25, 0.6) * n)
        top, left = rng.integers(0, n - side, 2)
        out[top : top + side, left : left + side] = leaves(128, rng)[
            np.arange(side)[:, None] * 128 // side, np.arange(side) * 128 // side
        ]
    for _ in range(int(rng.integers(1, 4))):
        tall = int(rng.uniform(0.06, 0.2) * n)
        _line(out, int(rng.uniform(0.03, 0.3) * n), int(rng.integers(0, n - tall)), tall, int(0.95 * n),
              int(rng.integers(3)), rng, 12)  # fmt: skip
    for _ in range(int(rng.integers(2, 9))):
        tall = int(rng.uniform(0.015, 0.035) * n) + 2
        left = int(rng.uniform(0.03, 0.6) * n)
        _line(out, left, int(rng.integers(0, n - tall)), tall, min(n - 4, left + n // 2), int(rng.integers(3)), rng)
    if rng.random() < 0.4:
        top, left, side = *rng.integers(0, int(0.8 * n), 2), n // 6
        out[top : top + side, left : left + side] = np.repeat(rng.random(side) < 0.5, 3).reshape(1, side, 3)
    return out


def motif(n: int, rng: np.random.Generator) -> Shares:
    """Flowers strewn over cloth or wallpaper: a figure of petals, mirrored, turned and repeated."""
    out = np.zeros((n, n, 3), np.float32)
    u, v = pixel_centres(n)
    petals, count = int(rng.integers(2, 8)), int(rng.integers(3, 14))
    for _ in range(count):
        x, y = (u - rng.random() + 0.5) % 1 - 0.5, (v - rng.random() + 0.5) % 1 - 0.5
        size, turn, kind = rng.uniform(0.06, 0.2), rng.uniform(0, 6), int(rng.integers(0, 3))
        far, angle = np.hypot(x, y) / size, np.arctan2(y, x) + turn
        shape = 0.55 + 0.45 * np.cos(petals * angle)
        inside = far < shape
        out[inside] = np.eye(3)[kind] * (0.6 + 0.4 * far[inside])[:, None]
        out[far < 0.22] = np.eye(3)[(kind + 1) % 3]
    return out


def rug(n: int, rng: np.random.Generator) -> Shares:
    """Borders within borders about a field mirrored both ways."""
    half = [dots, checks, zigzag, motif, stones][rng.integers(5)](n // 2, rng)
    out = np.concatenate([half, half[::-1]], 0)
    out = np.concatenate([out, out[:, ::-1]], 1)
    u, v = pixel_centres(n)
    edge = np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v))
    at = 0.0
    for wide in rng.uniform(0.01, 0.07, int(rng.integers(0, 6))):
        out[(edge >= at) & (edge < at + wide)] = np.eye(4, 3, -1)[rng.integers(4)]
        at += wide
    return np.clip(out * (1 + 0.15 * noise(n, 2, 1, rng)[..., None]), 0, 1)


def speckle(n: int, rng: np.random.Generator) -> Shares:
    """Granite, cork, coarse carpet, dust."""
    size = rng.uniform(0.7, 3)
    grains = noise(n, size, size, rng)
    return _shares(0.5 + rng.uniform(0.1, 0.8) * grains, (noise(n, size, size, rng) > rng.uniform(1, 2.5)) * 1.0)
