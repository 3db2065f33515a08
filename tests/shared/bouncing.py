"""A ball that bounces, in closed form: tracks for what trains and rolls."""

import numpy as np

from vidphys.diagnose.recordings.motion import motion_of

STEP, PULL, RESTITUTION, DROP = 1 / 30, 9.8, 0.8, 1.5


def height(time):
    """Above the floor, of a ball dropped from ``DROP`` at time zero."""
    began, speed = (2 * DROP / PULL) ** 0.5, RESTITUTION * (2 * PULL * DROP) ** 0.5
    if time < began:
        return DROP - PULL * time**2 / 2
    while time > began + 2 * speed / PULL:
        began, speed = began + 2 * speed / PULL, RESTITUTION * speed
    return (speed - PULL * (time - began) / 2) * (time - began)


def thrown(unit=1.0, second=1.0, noise=0.004):
    """A ball that flies on sideways while it bounces, in other units."""
    times = np.arange(120) * STEP
    q = np.stack([0.3 + 0.7 * times, [height(t) for t in times]], -1)[None, :, None]
    q = q + noise * np.random.default_rng(0).standard_normal(q.shape)
    return motion_of(unit * q, second * STEP)
