"""Answers to confusion scenes, by the diagnosis and by its baselines, and how they are scored."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vidphys.diagnose.diagnosis import Diagnosis
from vidphys.diagnose.infer import Inference
from vidphys.diagnose.menu import (
    FRICTION,
    FRICTIONS,
    Field,
    Term,
    external_terms,
    pair_terms,
)
from vidphys.diagnose.motion import Motion
from vidphys.experiments.confusion import Kind

DISSIPATIVE = frozenset({"linear", "square", "dry", "bath"})
FULL = frozenset({"pair", "trap", "linear", "bath"})
THRESHOLDS = np.geomspace(1e-3, 1.0, 13)  # of PySINDy's coefficients, columns of unit size
SMOOTHING = 11  # frames of PySINDy's derivative


@dataclass(frozen=True)
class Answer:
    """What a method says of a scene.

    Args:
        kinds: terms that it names.
        explained: false where it says that none of its terms explain the motion.
        sure: whether it claims to be sure.
    """

    kinds: frozenset[str]
    explained: bool = True
    sure: bool = True


def ours(found: Diagnosis) -> Answer:
    """The diagnosis; a switch is one more claim, which no confusion scene has."""
    switch = frozenset({"switch"}) if found.parts else frozenset()
    return Answer(found.kinds | switch, found.explained and not found.refused, found.sure)


def hamiltonian(inference: Inference) -> Answer:
    """The best model without friction or kicks, whatever it leaves."""
    for structure in inference.structures:
        if structure.term(FRICTION) is None:
            return Answer(structure.kinds)
    return Answer(inference.structure.kinds - DISSIPATIVE - {"drive"})


def full_menu(motion: Motion) -> Answer:
    """Everything, always."""
    return Answer(FULL if motion.bodies > 1 else FULL - {"pair"})


def has_pysindy() -> bool:
    """Whether the peer is installed (extra ``bench``)."""
    return importlib.util.find_spec("pysindy") is not None


def pysindy(motion: Motion) -> Answer:
    """Sequentially thresholded least squares on smoothed derivatives, chosen by Akaike.

    It is given our columns, one shape of pair force at a time, and the grouping into terms.
    """
    import pysindy as ps

    derive = ps.SmoothedFiniteDifference(smoother_kws={"window_length": SMOOTHING, "polyorder": 3})
    times = np.arange(motion.positions.shape[1]) * motion.interval
    flat = motion.positions.reshape(*motion.positions.shape[:2], -1)
    v = np.stack([derive(clip, times) for clip in flat])
    a = np.stack([derive(clip, times) for clip in v])
    shape = motion.positions.shape
    field = Field(
        motion.positions,
        v.reshape(shape),
        np.broadcast_to(times, shape[:2]),
        motion.mass,
        np.ones(motion.clips),
    )
    fixed = [external_terms(motion.space, False)[1], *FRICTIONS.values()]
    shapes: list[Term | None] = [None]
    if motion.bodies > 1:
        shapes += pair_terms(field.distance, "alike")
    known = np.concatenate([term.columns(field) for term in fixed], -1)
    best, least = Answer(frozenset()), np.inf
    for pair in shapes:
        columns = known if pair is None else np.concatenate([known, pair.columns(field)], -1)
        names = _names(fixed if pair is None else [*fixed, pair], motion.space)
        x, y = columns.reshape(-1, columns.shape[-1]), a.reshape(-1, 1)
        size = np.sqrt((x**2).mean(0)) + 1e-12
        for threshold in THRESHOLDS:
            fitted = ps.STLSQ(threshold=threshold, alpha=1e-6).fit(x / size, y)
            kept = fitted.coef_[0] != 0
            misfit = float(((y[:, 0] - (x / size) @ fitted.coef_[0]) ** 2).mean())
            score = len(y) * np.log(misfit + 1e-300) + 2 * (kept.sum() + (pair is not None))
            if score < least:
                best, least = Answer(_grouped(names, fitted.coef_[0])), score
    return best


def _names(terms: Sequence[Term], space: int) -> list[str]:
    """The kind of each column; constants of the trap's centre are a uniform field by themselves."""
    names = []
    for term in terms:
        own = [term.kind] * len(term.coefficients)
        names += ["trap", *["uniform"] * space] if term.kind == "trap" else own
    return names


def _grouped(names: Sequence[str], values: np.ndarray) -> frozenset[str]:
    found = {name for name, value in zip(names, values, strict=True) if value != 0}
    if "trap" in found:
        found.discard("uniform")
    if "linear" in found and values[list(names).index("linear")] < 0:
        found = (found - {"linear"}) | {"drive"}
    return frozenset(found)


@dataclass(frozen=True)
class Marked:
    """One scene with the answer to it."""

    kind: Kind
    answer: Answer

    @property
    def exact(self) -> bool:
        """Precisely the scene's terms, or "none of these" where the menu lacks one."""
        if self.kind.truth is None:
            return not self.answer.explained
        return self.answer.explained and self.answer.kinds == self.kind.truth


def scores(marked: Sequence[Marked]) -> dict[str, list[bool]]:
    """For every question, the scenes of which it is asked, answered by yes or no."""
    menu = [m for m in marked if m.kind.truth is not None]
    outside = [m for m in marked if m.kind.truth is None]
    still = [m for m in menu if not (m.kind.truth or frozenset()) & (DISSIPATIVE | {"drive"})]
    damped = [m for m in menu if (m.kind.truth or frozenset()) & DISSIPATIVE]
    return {
        "exact_structure": [m.exact for m in marked],
        "exact_structure_menu": [m.exact for m in menu],
        "friction_added": [bool(m.answer.kinds & DISSIPATIVE) for m in still],
        "friction_missed": [not m.answer.kinds & DISSIPATIVE for m in damped],
        "outside_refused": [not m.answer.explained for m in outside],
        "false_alarm": [not m.answer.explained for m in menu],
        "unsure": [m.answer.explained and not m.answer.sure for m in menu],
        "exact_when_sure": [m.exact for m in marked if m.answer.sure or not m.answer.explained],
    }
