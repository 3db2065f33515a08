"""A diagnosis in words for a person, and as data for a program."""

from __future__ import annotations

from typing import Any

import numpy as np

from vidphys.diagnose.diagnosis import Diagnosis
from vidphys.diagnose.explanations.equations import of_terms
from vidphys.diagnose.explanations.explanation import Explanation
from vidphys.diagnose.explanations.law_data import told_as_data
from vidphys.diagnose.explanations.menu import ASKED
from vidphys.diagnose.explanations.menu_model import specification
from vidphys.diagnose.explanations.menu_numbers import quantities_of
from vidphys.diagnose.explanations.verdict import EXPLAINED, FOUND_AGAIN, LONG, MOSTLY, NOT, Verdict
from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.recordings.identity import Identity
from vidphys.diagnose.recordings.noise import Noise
from vidphys.diagnose.recordings.units import Units
from vidphys.diagnose.telling.advice import Advice

BENT = (
    "What is left is more than noise: the force may not be quite this law's. A recording of larger "
    "and smaller swings would tell which it is."
)


def summary(found: Diagnosis, explanation: Explanation | None) -> list[str]:
    """What is said of the motion, a sentence each.

    Args:
        found: what the menu of terms says.
        explanation: that was chosen, where there is any.
    """
    if explanation is None:
        return [f"No answer: {found.refused}."]
    verdict, bodies = explanation.verdict, found.motion.bodies
    lines = [_verdict(verdict, bodies)] if verdict is not None else []
    lines += [BENT] if verdict is not None and verdict.bent else []
    return lines + explanation.lines()


def about(found: Diagnosis, identity: Identity, advice: Advice | None, units: Units) -> list[str]:
    """What is said of the recording, and what suffices to simulate and to film the scene.

    Args:
        found: gives the noise.
        identity: of the bodies.
        advice: where there is any.
        units: in which lengths are told.
    """
    lines = [identity.why + "."]
    lines += [_noise(found.noise, units)] if np.isfinite(found.noise.sigma) else []
    if advice is not None:
        lines += [_advised(advice)] if advice.fastest > 0 else []
        lines += advice.measured
    return lines


def _verdict(verdict: Verdict, bodies: int) -> str:
    """How far the answer may be trusted."""
    has = 100 * max(verdict.share, 0.0)
    text = f"{verdict.status.capitalize()}: the law has {has:.4g} % of the motion"
    if verdict.horizon is None:
        return text + "; nothing was held out that it could foretell."
    if verdict.stays:
        it, stay = ("it", "stays") if bodies == 1 else ("they", "stay")
        would = f" and would have foretold {_foretold(verdict)}, but"
        text += ", but does not foretell it:" if verdict.status == NOT else would
        return text + (
            f" over the last frames that were fitted, {it} might as well have stayed in place. So "
            f"the forecast is that {it} {stay} where last seen."
        )
    again = verdict.status == MOSTLY and verdict.missed < 1 - FOUND_AGAIN
    if again and verdict.horizon < LONG * verdict.held_out:
        return text + (
            f" and foretells {1 - verdict.missed:.0%} of the {verdict.held_out:.3g} s held out; it "
            f"is off for a while after {verdict.horizon:.3g} s."
        )
    return text + f" and foretells {_foretold(verdict)}."


def _foretold(verdict: Verdict) -> str:
    """How much of what was held out."""
    assert verdict.horizon is not None
    part = "all" if verdict.horizon >= verdict.held_out else f"{verdict.horizon:.3g} s"
    return f"{part} of the {verdict.held_out:.3g} s held out"


def _noise(noise: Noise, units: Units) -> str:
    sigma, step = (units.length(x) for x in (noise.sigma, noise.step))
    text = f"A coordinate has a noise of {sigma}; a body moves {step} from frame to frame"
    return text + ("." if noise.momentum_visible else ": its speed shows only over many frames.")


def _advised(advice: Advice) -> str:
    enough = "as here" if advice.enough_frames else "here there are fewer"
    return (
        f"To simulate it: {advice.integrator} with steps of {advice.dt:.2g} s; to film it: a frame "
        f"every {advice.frame_interval:.2g} s or more often ({enough})."
    )


def as_data(
    found: Diagnosis,
    identity: Identity,
    explanation: Explanation | None,
    advice: Advice | None,
    units: Units,
) -> dict[str, Any]:
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
        "status": _status(explanation),
        "explained": explanation is not None and explanation.explained,
        "sure": explanation is not None and bool(explanation.sure),
        "terms": explanation.kinds if explanation is not None else [],
        "mass": found.motion.mass[0].tolist(),
        "parts": [_part(part, found.motion.interval, units) for part in found.inferences],
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


def _status(explanation: Explanation | None) -> str:
    """One of the three; without frames held out, by what the fit leaves alone."""
    if explanation is None:
        return NOT
    if explanation.verdict is None and explanation.explained:
        return EXPLAINED if explanation.sure else MOSTLY
    if explanation.verdict is None:
        return NOT
    return explanation.verdict.status


def _part(inference: Inference, interval: float, units: Units) -> dict[str, Any]:
    left, known = inference.leftover, quantities_of(inference)
    return {
        **specification(inference, interval),
        "quantities": {x.name: told_as_data(x, units) for x in known},
        "equation": of_terms(inference, (x.name for x in known)).data,
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
