"""Bodies that go on by themselves until they meet, stepped in compiled loops.

With the place s and the velocity v = ds/dt of a body, between its collisions

    dv/dt = force - linear v - square |v| v - dry v/|v|

A collision takes place where the distance of two bodies falls to their reach. What one body gains
of momentum the other loses: along the line of centres their relative velocity turns round and
shrinks to ``restitution`` of itself, across it it loses the share ``rub``. Steps are fourth-order
Runge-Kutta; the step with a collision, a bounce off a wall or a halt ends there.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from loops import kernel, part, uncounted

HALVINGS = 45
MOST = 32  # events in a step
TINY = 1e-9  # of the speeds: bodies that approach so slowly touch


@part
def _accelerate(
    v: np.ndarray, force: np.ndarray, friction: np.ndarray, still: np.ndarray, out: np.ndarray
) -> None:
    for b in range(len(v)):
        speed = 0.0
        for i in range(v.shape[1]):
            speed += v[b, i] * v[b, i]
        speed = np.sqrt(speed)
        rate = friction[b, 0] + friction[b, 1] * speed
        if speed > 0.0:
            rate += friction[b, 2] / speed
        for i in range(v.shape[1]):
            out[b, i] = 0.0 if still[b] else force[i] - rate * v[b, i]


@part
def _ahead(v: np.ndarray, h: float, a: np.ndarray, out: np.ndarray) -> None:
    for b in range(len(v)):
        for i in range(v.shape[1]):
            out[b, i] = v[b, i] + h * a[b, i]


@uncounted
def _step(
    s: np.ndarray,
    v: np.ndarray,
    h: float,
    law: tuple,
    still: np.ndarray,
    work: np.ndarray,
) -> None:
    """One Runge-Kutta step from ``s``, ``v`` into ``work[5]``, ``work[6]``."""
    force, friction = law
    a1, a2, a3, a4, trial = work[0], work[1], work[2], work[3], work[4]
    _accelerate(v, force, friction, still, a1)
    _ahead(v, 0.5 * h, a1, trial)
    _accelerate(trial, force, friction, still, a2)
    _ahead(v, 0.5 * h, a2, trial)
    _accelerate(trial, force, friction, still, a3)
    _ahead(v, h, a3, trial)
    _accelerate(trial, force, friction, still, a4)
    for b in range(len(v)):
        for i in range(v.shape[1]):
            inner = a2[b, i] + a3[b, i]
            work[5, b, i] = s[b, i] + h * (v[b, i] + h / 6 * (a1[b, i] + inner))
            work[6, b, i] = v[b, i] + h / 6 * (a1[b, i] + 2 * inner + a4[b, i])


@uncounted
def _dot(a: np.ndarray, b: np.ndarray) -> float:
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@uncounted
def _apart(s: np.ndarray, one: int, two: int) -> float:
    total = 0.0
    for i in range(s.shape[1]):
        total += (s[two, i] - s[one, i]) ** 2
    return np.sqrt(total)


@uncounted
def _gap(s: np.ndarray, one: int, two: int, reach: float, side: float) -> float:
    """How far two bodies are from touching; on a line they keep their order."""
    if s.shape[1] == 1:
        return side * (s[two, 0] - s[one, 0]) - reach
    return _apart(s, one, two) - reach


@uncounted
def _closing(s: np.ndarray, v: np.ndarray, one: int, two: int, side: float) -> float:
    """Speed at which their distance falls."""
    if s.shape[1] == 1:
        return side * (v[one, 0] - v[two, 0])
    total = 0.0
    for i in range(s.shape[1]):
        total += (s[two, i] - s[one, i]) * (v[one, i] - v[two, i])
    return total / _apart(s, one, two)


@uncounted
def _nearest(s: np.ndarray, later: np.ndarray, one: int, two: int) -> float:
    """Share of a step after which two bodies are nearest, on straight lines."""
    square, toward = 0.0, 0.0
    for i in range(s.shape[1]):
        apart = s[two, i] - s[one, i]
        change = later[two, i] - later[one, i] - apart
        square += change * change
        toward -= apart * change
    return min(max(toward / square, 0.0), 1.0) if square > 0.0 else 1.0


@kernel
def _collide(
    s: np.ndarray,
    v: np.ndarray,
    one: int,
    two: int,
    side: float,
    lighter: np.ndarray,
    restitution: float,
    rub: float,
) -> None:
    normal = np.empty(s.shape[1])
    if s.shape[1] == 1:
        normal[0] = side
    else:
        normal[:] = s[two] - s[one]
        normal /= np.sqrt((normal * normal).sum())
    relative = v[two] - v[one]
    across = (relative * normal).sum()
    change = -(1 + restitution - rub) * across * normal - rub * relative
    push = change / (lighter[one] + lighter[two])
    v[one] -= lighter[one] * push
    v[two] += lighter[two] * push


@uncounted
def _until_halt(v: np.ndarray, body: int, law: tuple, still: np.ndarray, a: np.ndarray) -> float:
    """Seconds until dry friction halts a body that decelerates so; infinite where it never does."""
    force, friction = law
    if still[body] or friction[body, 2] <= np.sqrt(_dot(force, force)):
        return np.inf
    slowing = -_dot(v[body], a[body])
    return _dot(v[body], v[body]) / slowing if slowing > 0.0 else np.inf


@uncounted
def _until_contact(
    s: np.ndarray,
    v: np.ndarray,
    h: float,
    contact: np.ndarray,
    law: tuple,
    still: np.ndarray,
    work: np.ndarray,
) -> float:
    """Seconds until two bodies touch, infinite where they do not within ``h``.

    ``work`` holds the step of ``h`` from ``s``, ``v``, and afterwards another one.
    """
    one, two, reach, side = int(contact[0]), int(contact[1]), contact[2], contact[3]
    speeds = np.sqrt(_dot(v[one], v[one]) + _dot(v[two], v[two]))
    if _closing(s, v, one, two, side) <= TINY * speeds:
        return np.inf
    low, high = 0.0, h * _nearest(s, work[5], one, two)
    _step(s, v, high, law, still, work)
    if _gap(work[5], one, two, reach, side) >= 0.0:
        return np.inf
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        _step(s, v, middle, law, still, work)
        if _gap(work[5], one, two, reach, side) < 0.0:
            high = middle
        else:
            low = middle
    return high


@uncounted
def _beyond(s: np.ndarray, wall: np.ndarray) -> float:
    """How far a body is behind its wall."""
    return _dot(wall[1 : 1 + s.shape[1]], s[int(wall[0])]) - wall[1 + s.shape[1]]


@uncounted
def _until_wall(
    s: np.ndarray,
    v: np.ndarray,
    h: float,
    wall: np.ndarray,
    law: tuple,
    still: np.ndarray,
    work: np.ndarray,
) -> float:
    """The same until a body meets its wall."""
    if _beyond(work[5], wall) <= 0.0 or _dot(wall[1 : 1 + s.shape[1]], v[int(wall[0])]) <= 0.0:
        return np.inf
    low, high = 0.0, h
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        _step(s, v, middle, law, still, work)
        if _beyond(work[5], wall) > 0.0:
            high = middle
        else:
            low = middle
    return high


@uncounted
def _bounce(v: np.ndarray, wall: np.ndarray) -> None:
    """Turn a body's speed across its wall round; what is along it keeps a share of its own."""
    body, size = int(wall[0]), v.shape[1]
    across = _dot(wall[1 : 1 + size], v[body])
    restitution, along = wall[2 + size], wall[3 + size]
    for i in range(size):
        beside = v[body, i] - across * wall[1 + i]
        v[body, i] = along * beside - restitution * across * wall[1 + i]


@kernel
def _rolled(
    times: np.ndarray,
    start: np.ndarray,
    law: tuple,
    contacts: np.ndarray,
    walls: np.ndarray,
    lighter: np.ndarray,
    restitution: float,
    rub: float,
    out: np.ndarray,
) -> None:
    bodies = start.shape[1]
    work = np.zeros((7, bodies, start.shape[2]))
    s, v = start[0].copy(), start[1].copy()
    still = np.zeros(bodies, np.bool_)
    out[0, 0], out[0, 1] = s, v
    for frame in range(1, len(times)):
        left = times[frame] - times[frame - 1]
        for event in range(MOST + 1):
            when, touches, halts, bounces = left, -1, -1, -1
            _step(s, v, when, law, still, work)
            if event < MOST:
                for body in range(bodies):
                    soon = _until_halt(v, body, law, still, work[0])
                    if soon <= when:
                        when, halts = soon, body
                if halts >= 0:
                    _step(s, v, when, law, still, work)
                for k in range(len(contacts)):
                    soon = _until_contact(s, v, when, contacts[k], law, still, work)
                    if soon < when:
                        when, touches = soon, k
                    _step(s, v, when, law, still, work)
                for k in range(len(walls)):
                    soon = _until_wall(s, v, when, walls[k], law, still, work)
                    if soon < when:
                        when, bounces = soon, k
                    _step(s, v, when, law, still, work)
            s[:], v[:] = work[5], work[6]
            left -= when
            if bounces >= 0:
                _bounce(v, walls[bounces])
            elif touches >= 0:
                one, two = int(contacts[touches, 0]), int(contacts[touches, 1])
                _collide(s, v, one, two, contacts[touches, 3], lighter, restitution, rub)
                still[one], still[two] = False, False
            elif halts >= 0:
                v[halts] = 0.0
                still[halts] = True
            else:
                break
        out[frame, 0], out[frame, 1] = s, v


def rolled(
    times: Float[np.ndarray, " t"],
    start: Float[np.ndarray, "2 n d"],
    force: Float[np.ndarray, " d"],
    friction: Float[np.ndarray, "n 3"],
    masses: Float[np.ndarray, " n"],
    contacts: Float[np.ndarray, "c 4"],
    restitution: float,
    rub: float,
    walls: Float[np.ndarray, "w _"] | None = None,
) -> Float[np.ndarray, "t 2 n d"]:
    """Places and velocities at each time.

    Args:
        times: seconds, increasing; the start is at the first.
        start: places and velocities.
        force: acceleration of all bodies.
        friction: of each body the linear rate, the square one, and the dry deceleration.
        masses: only their ratios count.
        contacts: of each pair that may meet: the two bodies, their reach, and on a line the sign
            of the second's place as the first sees it.
        restitution, rub: see the module.
        walls: of each the body that bounces off it, its normal ``(d,)``, place, restitution, and
            the share of the speed along it that a bounce leaves; none where not given.
    """
    out = np.empty((len(times), *start.shape))
    law = (force, friction)
    walls = np.zeros((0, start.shape[2] + 4)) if walls is None else walls
    _rolled(times, start, law, contacts, walls, 1 / masses, restitution, rub, out)
    return out
