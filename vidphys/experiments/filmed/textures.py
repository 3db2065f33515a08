"""Pictures that walls, floors and bodies are papered with; all of them tile."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Random = np.random.Generator
SIDE = 512


def cloud(random: Random, slope: float, side: int = SIDE) -> np.ndarray:
    """Noise ``(side, side)`` of mean 0 and deviation 1 whose amplitude falls as f^-slope."""
    fx, fy = np.meshgrid(np.fft.fftfreq(side), np.fft.fftfreq(side))
    scale = np.maximum(np.hypot(fx, fy), 1 / side) ** -slope
    scale[0, 0] = 0.0
    noise = np.fft.ifft2(np.fft.fft2(random.normal(size=(side, side))) * scale).real
    return noise / noise.std()


def _toned(colour: np.ndarray, shade: np.ndarray) -> np.ndarray:
    """A colour ``(3,)`` in 0..1 under a shade ``(h, w)`` about 1, as bytes."""
    return (np.clip(colour * shade[..., None], 0, 1) * 255).astype(np.uint8)


def plaster(random: Random) -> np.ndarray:
    """A painted wall."""
    colour = np.array([0.82, 0.8, 0.75]) * random.uniform(0.7, 1.1) + random.normal(0, 0.04, 3)
    return _toned(colour, 1 + 0.02 * cloud(random, 1.4) + 0.02 * cloud(random, 0.3))


def paper(random: Random) -> np.ndarray:
    """Striped wallpaper."""
    colour = random.uniform(0.45, 0.85, 3)
    wave = np.sin(2 * np.pi * int(random.integers(6, 14)) * np.arange(SIDE) / SIDE)
    stripes = 1 + random.uniform(0.03, 0.1) * np.clip(4 * wave, -1, 1)
    return _toned(colour, stripes[None] * (1 + 0.03 * cloud(random, 0.8)))


def brick(random: Random) -> np.ndarray:
    """A wall of bricks."""
    rows, columns = 12, 5
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE
    row = np.floor(y * rows).astype(int)
    across = x * columns + 0.5 * (row % 2)
    tone = random.uniform(0.75, 1.1, (rows, columns))
    shade = tone[row, np.floor(across).astype(int) % columns] * (1 + 0.07 * cloud(random, 0.8))
    joint = ((y * rows) % 1 < 0.1) | (across % 1 < 0.05)
    bricks = _toned(np.array([0.6, 0.36, 0.28]) + random.normal(0, 0.04, 3), shade)
    bricks[joint] = 165
    return bricks


def wood(random: Random) -> np.ndarray:
    """Planks."""
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE
    planks = 6
    plank = np.floor(y * planks).astype(int)
    tone = random.uniform(0.75, 1.1, planks)[plank]
    grain = np.repeat(cloud(random, 0.9)[:, ::16], 16, 1)
    shade = tone * (1 + 0.06 * grain + 0.03 * cloud(random, 1.2))
    shade[(y * planks) % 1 < 0.025] *= 0.55
    return _toned(np.array([0.62, 0.45, 0.28]) * random.uniform(0.6, 1.2), shade)


def carpet(random: Random) -> np.ndarray:
    """A carpet, or asphalt: grain without an order."""
    shade = 1 + 0.12 * cloud(random, 0.2) + 0.05 * cloud(random, 1.2)
    return _toned(random.uniform(0.2, 0.6) + random.normal(0, 0.06, 3), shade)


def poster(random: Random) -> np.ndarray:
    """A picture of patches, lines and a wash of colour."""
    wash = [0.5 + 0.16 * cloud(random, 1.8, 256) for _ in range(3)]
    picture = np.stack(wash, -1)
    for _ in range(int(random.integers(5, 14))):
        y, x = random.integers(0, 220, 2)
        h, w = random.integers(6, 90, 2)
        picture[y : y + h, x : x + w] = random.uniform(0, 1, 3)
    for k in range(int(random.integers(0, 9))):  # lines of print
        picture[20 + 9 * k : 23 + 9 * k, 30 : int(random.integers(120, 225))] = 0.15
    return (np.clip(picture, 0, 1) * 255).astype(np.uint8)


def ball(random: Random) -> np.ndarray:
    """A ball's skin: one strong colour, plain, felted, with a stripe or in patches."""
    colour = vivid(random)
    kind = random.choice(["plain", "felt", "stripe", "patches"], p=[0.35, 0.25, 0.2, 0.2])
    skin = _toned(colour, 1 + (0.09 if kind == "felt" else 0.02) * cloud(random, 0.5, 128))
    if kind == "stripe":
        skin[52:76] = 235
    if kind == "patches":
        skin[cloud(random, 2.2, 128) > 0.8] = (vivid(random) * 255).astype(np.uint8)
    return skin


def vivid(random: Random) -> np.ndarray:
    """A colour ``(3,)`` that stands out a little."""
    import colorsys

    hue, full = random.uniform(), random.uniform(0.55, 0.95)
    return np.array(colorsys.hsv_to_rgb(hue, full, random.uniform(0.45, 0.95)))


def skin(random: Random) -> np.ndarray:
    """A hand's."""
    colour = np.array([0.86, 0.64, 0.52]) * random.uniform(0.45, 1.05)
    return _toned(colour, 1 + 0.05 * cloud(random, 1.0, 128))


def cloth(random: Random) -> np.ndarray:
    """A sleeve or a coat."""
    y, x = np.mgrid[:128, :128]
    weave = 0.04 * (((x // 2 + y // 2) % 2) - 0.5)
    return _toned(vivid(random) * 0.7, 1 + weave + 0.07 * cloud(random, 1.3, 128))


def ruler(_: Random) -> np.ndarray:
    """Yellow wood with a line a centimetre, ten to the height."""
    strip = np.full((400, 400, 3), (222, 196, 120), np.uint8)
    for k in range(0, 400, 40):
        strip[k : k + 5, : 380 if k % 200 == 0 else 220] = 25
    return strip.swapaxes(0, 1)


def metal(random: Random) -> np.ndarray:
    """Brushed."""
    shade = 1 + 0.05 * np.repeat(cloud(random, 0.3, 128)[:, :1], 128, 1)
    return _toned(np.full(3, random.uniform(0.35, 0.8)), shade)


TEXTURES: dict[str, Callable[[Random], np.ndarray]] = {
    each.__name__: each
    for each in (
        plaster,
        paper,
        brick,
        wood,
        carpet,
        poster,
        ball,
        skin,
        cloth,
        ruler,
        metal,
    )
}
WALLS = ("plaster", "plaster", "paper", "brick", "wood")
FLOORS = ("wood", "carpet", "carpet")
