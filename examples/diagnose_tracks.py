"""Find the law of a recorded motion: a body on a spring with friction."""

import numpy as np

from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.telling.answers import answer

step = 1 / 30  # seconds between frames
t = np.arange(300) * step
fading = np.exp(-0.12 * t)
places = np.stack([fading * np.cos(2.2 * t), 0.6 * fading * np.sin(2.2 * t)], -1)
places += np.random.default_rng(0).normal(0, 2e-3, places.shape)

clips = places[None, :, None]  # clips, frames, bodies, space
found = answer(motion_of(clips, step), angles=False, hold_out=0.3)
print(*found.lines, sep="\n")
