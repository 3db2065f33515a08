"""What suffices of what was measured on this machine: an integrator with its step, an encoder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.recordings.noise import Noise, blur_seen
from vidphys.diagnose.telling.advice import Advice
from vidphys.points.pick import Bound, Choice, pick
from vidphys.points.point import Point


def with_measured(advice: Advice, motion: Motion, noise: Noise, points: Sequence[Point]) -> Advice:
    """Advice with the cheapest measured integrator and encoder that this recording asks for.

    Steps are carried over by what they turn the fastest motion by, errors by their share of the
    size of a state: an integrator suffices whose error stays below the noise, an encoder that
    reads positions exactly enough for speeds to show from frame to frame.

    Args:
        advice: by rule.
        motion, noise: of the recording.
        points: measured by `vidphys trade`.
    """
    spread = motion.spread
    told_apart = blur_seen(noise.step, motion.space) / spread
    rollouts = [p for p in points if p.front == "rollouts" and "radians" in p.units]
    encoders = [p for p in points if p.front == "encoders"]
    rolled = _cheapest(rollouts, Bound("state_error", noise.sigma / spread))
    looked = _cheapest(encoders, Bound("probe_nmse", told_apart**2))
    told = []
    if rolled is not None and advice.fastest > 0:
        told.append(f"Rolled with an error below the noise, as measured: {rolled.sentence}.")
        if rolled.met:
            dt = rolled.point.units["radians"] / advice.fastest
            integrator = str(rolled.point.configuration["integrator"])
            advice = replace(advice, dt=dt, integrator=integrator)
    if looked is not None:
        told.append(f"Seen so that speeds show, as measured: {looked.sentence}.")
    return replace(advice, measured=tuple(told))


def _cheapest(points: Sequence[Point], bound: Bound) -> Choice | None:
    """The choice among points whose result was finite; ``None`` where there are none."""
    some = [p for p in points if p.error is not None]
    return pick(some, bound)[0] if some else None
