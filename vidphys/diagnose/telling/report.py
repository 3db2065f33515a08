"""A diagnosis in words for a person, and as data for a program."""

from __future__ import annotations

from typing import Any

import numpy as np

from vidphys.diagnose.diagnosis import Diagnosis
from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.recordings.identity import Identity
from vidphys.diagnose.telling.advice import Advice
from vidphys.diagnose.telling.specification import specification, temperature
from vidphys.diagnose.wall.beside import BesideWall
from vidphys.statistics import NORMAL_95

ASKED = (
    "pair",
    "contact",
    "uniform",
    "trap",
    "well",
    "pendulum",
    "linear",
    "square",
    "dry",
    "drive",
)
LIKELY, UNLIKELY = 0.9, 0.1
WORDS = {
    "pair": "a force between pairs",
    "contact": "contacts",
    "uniform": "a uniform field",
    "trap": "a trap",
    "well": "a well whose sides differ",
    "pendulum": "a pendulum's weight",
    "linear": "friction that goes with the speed",
    "square": "friction that goes with its square",
    "dry": "dry friction",
    "drive": "a drive that adds energy",
    "bath": "random kicks of a heat bath",
}


def summary(
    found: Diagnosis, identity: Identity, advice: Advice | None, wall: BesideWall | None
) -> list[str]:
    """What a person should know, a sentence each.

    Args:
        found: what the menu of terms says.
        identity: of the bodies.
        advice: where there is any.
        wall: that explains the recording where the menu does not, or only by a heat bath.
    """
    lines = [identity.why + ".", _noise(found)]
    if found.refused or found.inference is None:
        return [*lines, f"No answer: {found.refused}."]
    if wall is not None:
        alone = f"The menu's terms alone would show {_named(found.inference)}."
        lines += [wall.line(), alone]
    else:
        lines += _of_menu(found)
    if advice is not None:
        lines += [_advised(advice)] if advice.fastest > 0 else []
        lines += advice.measured
    return lines


def _of_menu(found: Diagnosis) -> list[str]:
    """Which of the menu's terms the motion shows, and what stays open."""
    assert found.inference is not None
    lines = []
    if found.switch is not None and found.parts:
        lines.append(
            f"Something changes at {found.switch.time:.4g} s (frame {found.switch.frame}); before "
            f"it: {_named(found.parts[0])}; after it: {_named(found.parts[1])}."
        )
    else:
        lines.append(f"The motion shows {_named(found.inference)}.")
    lines += [f"  {line}" for part in _parts(found) for line in _numbers(part)]
    lines += _uncertain(found)
    if not np.allclose(found.motion.mass, 1.0):
        ratio = found.motion.mass[0] / found.motion.mass[0, 0]
        masses = " : ".join(f"{x:.3g}" for x in ratio)
        lines.append(f"Masses as {masses}; motion shows only their ratios.")
    if not found.explained:
        lines.append(f"None of the menu's terms explains all of it: {_why(found)}.")
    if found.power is not None:
        lines.append(f"Power of the coupling: {found.power.why}.")
    return lines


def _parts(found: Diagnosis) -> tuple[Inference, ...]:
    return found.parts or ((found.inference,) if found.inference else ())


def _why(found: Diagnosis) -> str:
    left = [part.leftover.why for part in _parts(found) if not part.leftover.explained]
    return "; ".join(left)


def _noise(found: Diagnosis) -> str:
    noise = found.noise
    seen = (
        "speeds show from frame to frame"
        if noise.momentum_visible
        else ("speeds show only over many frames")
    )
    return f"Positions have a noise of {noise.sigma:.3g}; {noise.why}: {seen}."


def _named(inference: Inference) -> str:
    kinds = [WORDS.get(kind, kind) for kind in sorted(inference.kinds)]
    return ", ".join(kinds) if kinds else "inertia and nothing else"


def _numbers(inference: Inference) -> list[str]:
    fitted = inference.fitted
    lines = []
    for term in inference.terms:
        at = fitted.place(term)
        values = [
            f"{name} {fitted.values[k]:.4g} ± {NORMAL_95 * fitted.errors[k]:.2g}"
            for k, name in enumerate(term.coefficients, at)
        ]
        if term.scale is not None:
            values.append(f"length {fitted.values[-1]:.4g} ± {NORMAL_95 * fitted.errors[-1]:.2g}")
        lines.append(f"{term.kind}: {', '.join(values)} (95 %)")
    if inference.bathed:
        lines.append(f"bath: temperature {temperature(inference):.3g} (unit masses, k_B = 1)")
    return lines


def _uncertain(found: Diagnosis) -> list[str]:
    """Terms that the data neither show nor rule out."""
    if found.inference is None or found.parts:
        return []
    open_terms = [
        f"{WORDS[kind]} ({chance:.0%})"
        for kind in ASKED
        if UNLIKELY < (chance := found.inference.chance(kind)) < LIKELY
    ]
    if not open_terms:
        return []
    return [f"Not certain, record longer or with less noise: {', '.join(open_terms)}."]


def _advised(advice: Advice) -> str:
    enough = "the recording has them" if advice.enough_frames else "the recording has fewer"
    return (
        f"To roll it: {advice.integrator} with steps of {advice.dt:.2g} s; to see it: a frame "
        f"every {advice.frame_interval:.2g} s or more often ({enough})."
    )


def as_data(found: Diagnosis, identity: Identity, advice: Advice | None) -> dict[str, Any]:
    """The diagnosis as JSON: every answer with its evidence; unknown numbers are null."""
    data: dict[str, Any] = {
        "bodies": identity.bodies,
        "identity": {
            "seen": identity.seen.tolist(),
            "crossings": identity.crossings,
            "jumps": identity.jumps,
        },
        "noise": {
            "sigma": found.noise.sigma,
            "order": found.noise.order,
            "momentum_visible": found.noise.momentum_visible,
        },
        "refused": found.refused,
        "explained": found.explained,
        "sure": found.sure,
        "terms": sorted(found.kinds),
        "mass": found.motion.mass[0].tolist(),
        "parts": [_part(part, found.motion.interval) for part in _parts(found)],
    }
    if found.switch is not None:
        switch = found.switch
        data["switch"] = {"frame": switch.frame, "time": switch.time, "gain": switch.gain}
    if found.power is not None:
        data["power"] = {
            "supported": list(found.power.supported),
            "query": found.power.query,
            "why": found.power.why,
        }
    if advice is not None and np.isfinite(advice.frame_interval):
        data["advice"] = {
            "dt": advice.dt,
            "integrator": advice.integrator,
            "frame_interval": advice.frame_interval,
            "enough_frames": advice.enough_frames,
            "measured": list(advice.measured),
        }
    return data


def _part(inference: Inference, interval: float) -> dict[str, Any]:
    left = inference.leftover
    return {
        **specification(inference, interval),
        "probability": {kind: inference.chance(kind) for kind in ASKED},
        "structures": [
            {"terms": sorted(kinds), "probability": value}
            for kinds, value in sorted(inference.probability.items(), key=lambda x: -x[1])[:5]
        ],
        "leftover": {
            "residual_over_noise": float(np.sqrt(left.excess)),
            "allowed": float(np.sqrt(left.allowed)),
            "gain_by_random_kicks": left.kicks_gain,
            "gain_by_a_smooth_force": left.smooth_gain,
            "probes": left.probes,
            "why": left.why,
        },
    }
