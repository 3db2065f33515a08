"""Tossed, falling, bouncing and rolling bodies, and pucks that meet."""

from __future__ import annotations

import numpy as np

from vidphys.experiments.filmed.laws.flights import BOUNCE, DRAG, ROLL, TOSS
from vidphys.experiments.filmed.laws.law import GRAVITY
from vidphys.experiments.filmed.laws.pucks import PUCKS
from vidphys.experiments.filmed.scenes.scene import (
    Fixture,
    Held,
    Look,
    Number,
    Scene,
    numbers_of,
)

Generator = np.random.Generator
ROLLING_BALL = 5 / 7  # of the weight's part along an incline that moves a solid ball
GRAVITY_NUMBER = Number("g", GRAVITY, "m/s^2")


def _toss(random: Generator, kind: str, hand: bool) -> Scene:
    flight = random.uniform(0.6, 0.9) if hand else random.uniform(0.8, 1.15)
    up = GRAVITY * flight / 2
    across = random.uniform(0.5, 1.6) * random.choice([-1, 1])
    held = None
    if hand:
        way = (-0.5 * float(np.sign(across)), -0.87)
        held = Held(0, random.uniform(0.5, 0.9), way, velocity=(across, up))
    look = Look("ball", random.uniform(0.05, 0.1), spin=random.uniform(-6, 6))
    seconds = flight * random.uniform(0.95, 1.05) + (held.seconds if held else 0.0)
    return Scene(kind, TOSS, (across, up), (GRAVITY_NUMBER,), seconds, (look,), (), (), held=held)


def toss(random: Generator) -> Scene:
    """A ball on its flight; who threw it is out of the picture."""
    return _toss(random, "toss", hand=False)


def toss_hand(random: Generator) -> Scene:
    """A hand throws a ball up and stays in view."""
    return _toss(random, "toss hand", hand=True)


def _bounce(random: Generator, kind: str, hand: bool) -> Scene:
    restitution, height = random.uniform(0.6, 0.9), random.uniform(0.7, 1.3)
    across = 0.0 if hand else random.uniform(0.15, 0.45) * random.choice([-1, 1])
    radius = random.uniform(0.035, 0.075)
    held = Held(0, random.uniform(1.0, 1.8), (0.8, 0.6)) if hand else None
    first = np.sqrt(2 * height / GRAVITY)
    dies = first * (1 + 2 * restitution / (1 - restitution))
    seconds = min(0.9 * dies, random.uniform(3.0, 4.5)) + (held.seconds if held else 0.0)
    told = [("restitution", restitution, "1")]
    return Scene(
        kind,
        BOUNCE,
        (restitution, height, across, 0.0),
        (*numbers_of(told, 0), GRAVITY_NUMBER),
        seconds,
        (Look("ball", radius, spin=random.uniform(-3, 3)),),
        (),
        (Fixture("floor", (0.0, -radius), (0.0, -radius)),),
        held=held,
    )


def bounce(random: Generator) -> Scene:
    """A ball that falls, goes along and bounces several times."""
    return _bounce(random, "bounce", hand=False)


def drop_hand(random: Generator) -> Scene:
    """A hand lets a ball drop, and stays while it bounces."""
    return _bounce(random, "drop hand", hand=True)


def roll(random: Generator) -> Scene:
    """A ball that rolls along the floor and slows evenly."""
    speed, far = random.uniform(0.6, 1.0), random.uniform(0.9, 1.6)
    slowing = speed**2 / (2 * far)
    side, radius = random.choice([-1, 1]), random.uniform(0.04, 0.08)
    seconds = 0.92 * speed / slowing
    return Scene(
        "roll",
        ROLL,
        (-slowing, speed, side, 0.0),
        tuple(numbers_of([("deceleration", slowing, "m/s^2")], 0)),
        min(seconds, 5.0),
        (Look("ball", radius, rolls=True),),
        (),
        (Fixture("floor", (0.0, -radius), (0.0, -radius)),),
    )


def incline(random: Generator) -> Scene:
    """A ball that rolls down a plank from rest."""
    angle, length = np.radians(random.uniform(3, 9)), random.uniform(0.7, 1.3)
    side, radius = random.choice([-1.0, 1.0]), random.uniform(0.03, 0.055)
    acceleration = ROLLING_BALL * GRAVITY * np.sin(angle)
    x, y = side * np.cos(angle), -np.sin(angle)
    below = radius * np.array([-side * np.sin(angle), -np.cos(angle)])
    ends = [tuple(below + along * np.array([x, y])) for along in (-0.12, length + 0.08)]
    return Scene(
        "incline",
        ROLL,
        (acceleration, 0.0, x, y),
        tuple(numbers_of([("acceleration", acceleration, "m/s^2")], 0)),
        float(np.sqrt(2 * length / acceleration)),
        (Look("ball", radius, rolls=True),),
        (),
        (Fixture("ramp", ends[0], ends[1]),),
    )


def fall(random: Generator) -> Scene:
    """A light body that comes near to its terminal speed."""
    terminal, height = random.uniform(1.3, 2.2), random.uniform(1.5, 2.2)
    drag = GRAVITY / terminal**2
    seconds = (height + np.log(2) / drag) / terminal
    told = [("drag", drag, "1/m"), ("terminal_speed", terminal, "m/s")]
    return Scene(
        "fall",
        DRAG,
        (drag, 0.0, 0.0),
        (*numbers_of(told, 0), GRAVITY_NUMBER),
        float(seconds),
        (Look("cup", random.uniform(0.08, 0.13)),),
    )


def pucks(random: Generator) -> Scene:
    """Two pucks on an air table, seen from above, that meet once."""
    ratio, restitution = random.uniform(1.0, 3.0), random.uniform(0.7, 1.0)
    small = random.uniform(0.032, 0.045)
    radii = np.array([small, small * ratio**0.5])
    if random.random() < 0.5:
        ratio, radii = 1 / ratio, radii[::-1]
    reach, when = float(radii.sum()), random.uniform(1.2, 1.8)
    turn, off = random.uniform(0, 2 * np.pi), random.uniform(-0.6, 0.6)
    normal = np.array([np.cos(turn), np.sin(turn)])
    heading = np.array([np.cos(turn + off), np.sin(turn + off)])
    first = heading * random.uniform(0.22, 0.4)
    second = -heading * random.uniform(0.0, 0.2) + random.normal(0, 0.03, 2)
    places = -normal * reach / 2 - first * when, normal * reach / 2 - second * when
    told = [("mass_ratio", ratio, "1"), ("restitution", restitution, "1")]
    looks = tuple(Look("disc", float(r), spin=float(random.uniform(-1.5, 1.5))) for r in radii)
    return Scene(
        "pucks",
        PUCKS,
        (ratio, restitution, reach, *places[0], *places[1], *first, *second),
        tuple(numbers_of(told)),
        2.2 * when,
        looks,
        flat=True,
    )
