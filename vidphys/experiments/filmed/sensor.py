"""From the studio's pictures to the sensor's: rows, lens, exposure, noise, and when frames come."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vidphys.data.formats.opencv import opencv
from vidphys.experiments.filmed.camera import Lens, Stand
from vidphys.experiments.filmed.nuisances import Nuisances

MOMENTS = 5  # of an exposure that blurs
EXTREMES = 200  # times at which the camera's turns are looked at
GRAINS = 8  # pictures of noise that are shifted about
VIGNETTE = 0.16  # darker in the corners
TINT = 0.03  # of the white balance


class Shutter:
    """Bends the studio's picture as the lens does, row by row as the camera turns.

    The studio's camera stands; turning it is but another way to bend its picture.

    Args:
        lens, stand: of the camera.
        readout: seconds from the first row to the last.
        seconds: of the clip.
    """

    def __init__(self, lens: Lens, stand: Stand, readout: float, seconds: float) -> None:
        self._lens, self._stand = lens, stand
        self._late = (np.arange(lens.height) / (lens.height - 1) - 0.5) * readout
        self._straight = not stand.turns and not lens.radial
        self._rays = lens.rays()
        self.size = (lens.height, lens.width)
        if not self._straight:
            times = np.linspace(-readout, seconds + readout, EXTREMES)
            axes = stand.axes @ stand.poses(times)[1].swapaxes(-1, -2)
            rim = np.concatenate([self._rays[[0, -1]].reshape(-1, 3), *self._rays[:, [0, -1]]])
            far = np.abs(self._flat(np.einsum("tij,rj->tri", axes, rim))).max((0, 1))
            width, height = (2 * np.ceil(far * lens.focal + 2).astype(int)).tolist()
            self.size = (height, width)
        self._map = self._places(self._rays)

    def bend(self, picture: np.ndarray, time: float) -> np.ndarray:
        """The picture ``(H, W, 3)`` of the lens, from the studio's at a time in seconds."""
        if self._straight:
            return picture
        cv2 = opencv()
        where = self._places(self._turned(time)) if self._stand.turns else self._map
        return cv2.remap(picture, where[..., 0], where[..., 1], cv2.INTER_LINEAR)

    def _turned(self, time: float) -> np.ndarray:
        """Each row's rays along the axes of the studio's camera."""
        rows = self._stand.axes @ self._stand.poses(time + self._late)[1].swapaxes(-1, -2)
        return self._rays @ rows.swapaxes(-1, -2)

    def _flat(self, rays: np.ndarray) -> np.ndarray:
        return rays[..., :2] / -rays[..., 2:] * [1, -1]

    def _places(self, rays: np.ndarray) -> np.ndarray:
        centre = (np.array(self.size[::-1]) - 1) / 2
        return (centre + self._lens.focal * self._flat(rays)).astype(np.float32)


class Sensor:
    """Exposure, brightness and noise.

    Args:
        random: of the noise and the drift.
        lens: gives the size.
        add: what is added.
        seconds: of the clip.
    """

    def __init__(
        self, random: np.random.Generator, lens: Lens, add: Nuisances, seconds: float
    ) -> None:
        self._random, self._add, self._seconds = random, add, seconds
        y, x = np.mgrid[: lens.height, : lens.width]
        off = np.hypot(x - lens.centre[0], y - lens.centre[1]) / np.hypot(*lens.centre)
        tint = 1 + random.uniform(-TINT, TINT, 3)
        self._shade = ((1 - VIGNETTE * off**2)[..., None] * tint).astype(np.float32)
        shape = (GRAINS, lens.height, lens.width)
        grey = random.standard_normal((*shape, 1), np.float32)
        colour = random.standard_normal((*shape, 3), np.float32)
        self._grains = add.noise * (0.8 * grey + 0.6 * colour)
        self._waves = random.uniform(0.4, 1.3, 2), random.uniform(0, 2 * np.pi, 2)

    def moments(self, time: float) -> np.ndarray:
        """Seconds at which a frame is looked at."""
        if not self._add.shutter:
            return np.array([time])
        steps = (np.arange(MOMENTS) + 0.5) / MOMENTS - 0.5
        return time + steps * self._add.shutter

    def read(self, moments: Sequence[np.ndarray], time: float) -> np.ndarray:
        """The frame ``(H, W, 3)``, RGB bytes, from the pictures of its moments."""
        light = moments[0].astype(np.float32)
        for other in moments[1:]:
            light += other
        light *= self._shade * np.float32(self.gain(time) / len(moments))
        grain = self._grains[self._random.integers(GRAINS)]
        shift = tuple(self._random.integers(0, 300, 2).tolist())
        light += np.roll(grain, shift, (0, 1))
        return np.clip(light + 0.5, 0, 255).astype(np.uint8)

    def gain(self, time: float) -> float:
        """Brightness of the frame at a time in seconds, about 1."""
        turns, phases = self._waves
        wave = np.sin(2 * np.pi * turns * time / self._seconds + phases)
        return float(1 + self._add.drift * wave.mean())


def timing(
    random: np.random.Generator, seconds: float, add: Nuisances
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps and true times ``(t,)``, and for each frame the one whose picture it shows."""
    count = max(int(seconds * add.rate), 8)
    slots = np.arange(count) / add.rate
    slots[1:] += np.clip(random.normal(0, 1, count - 1) * add.jitter, -0.4, 0.4) / add.rate
    kept = random.random(count) >= add.dropped
    kept[0] = True
    times = slots[kept]
    stamps = times if add.told else np.arange(len(times)) / add.rate
    shown = np.arange(len(times))
    twice = np.flatnonzero(random.random(len(times)) < add.doubled)
    twice = twice[twice > 0]
    shown[twice] = twice - 1
    for k in twice:  # a picture that comes three times is one picture
        shown[k] = shown[k - 1]
    return stamps, times[shown], shown
