"""Answers to confusion scenes, by the diagnosis and by its baselines, and how they are scored."""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vidphys.diagnose.diagnosis import Diagnosis
from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.inference.menu import (
    FRICTION,
    FRICTIONS,
    Field,
    Term,
    external_terms,
    pair_terms,
)
from vidphys.diagnose.recordings.motion import Motion
from vidphys.experiments.confusion.scenes import Kind

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

    It is given our columns, the shape of pair force that fits best, and the grouping into terms.
    """
    field, a = _differentiated(motion)
    fixed = [external_terms(motion.space, False)[1], *FRICTIONS.values()]
    y = a.reshape(-1)
    terms = fixed
    if motion.bodies > 1:
        tried = [[*fixed, pair] for pair in pair_terms(field.distance, "alike")]
        terms = min(tried, key=lambda some: misfit_of(_design(field, some), y))
    x, names = _design(field, terms), names_of(terms, motion.space)
    return Answer(grouped(names, thresholded(x / np.sqrt((x**2).mean(0) + 1e-24), y)))


def _differentiated(motion: Motion) -> tuple[Field, np.ndarray]:
    """States by PySINDy's smoothed differences, and accelerations by the same once more."""
    import pysindy as ps

    derive = ps.SmoothedFiniteDifference(smoother_kws={"window_length": SMOOTHING, "polyorder": 3})
    times = np.arange(motion.positions.shape[1]) * motion.interval
    flat = motion.positions.reshape(*motion.positions.shape[:2], -1)
    v = np.stack([derive(clip, times) for clip in flat])
    a = np.stack([derive(clip, times) for clip in v])
    at = np.broadcast_to(times, flat.shape[:2])
    shape = motion.positions.shape
    field = Field(motion.positions, v.reshape(shape), at, motion.mass, np.ones(motion.clips))
    return field, a.reshape(shape)


def _design(field: Field, terms: Sequence[Term]) -> np.ndarray:
    columns = np.concatenate([term.columns(field) for term in terms], -1)
    return columns.reshape(-1, columns.shape[-1])


def misfit_of(x: np.ndarray, y: np.ndarray) -> float:
    """Mean square that least squares on columns ``(r, p)`` leave of ``(r,)``."""
    return float(((y - x @ np.linalg.lstsq(x, y, rcond=None)[0]) ** 2).mean())


def thresholded(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Coefficients at the threshold that Akaike's criterion likes best."""
    import pysindy as ps

    best, least = np.zeros(x.shape[1]), np.inf
    for threshold in THRESHOLDS:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that a threshold leaves nothing
            found = ps.STLSQ(threshold=threshold, alpha=1e-6).fit(x, y[:, None]).coef_[0]
        misfit = float(((y - x @ found) ** 2).mean())
        score = len(y) * np.log(misfit + 1e-300) + 2 * np.count_nonzero(found)
        if score < least:
            best, least = found, score
    return best


def names_of(terms: Sequence[Term], space: int) -> list[str]:
    """The kind of each column; constants of the trap's centre are a uniform field by themselves."""
    names = []
    for term in terms:
        own = [term.kind] * len(term.coefficients)
        names += ["trap", *["uniform"] * space] if term.kind == "trap" else own
    return names


def grouped(names: Sequence[str], values: np.ndarray) -> frozenset[str]:
    """Kinds of the columns whose numbers are not zero."""
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
