"""Which power of the coupling: what pair forces of clips at several known couplings allow."""

from __future__ import annotations

import numpy as np

from dynamics.powers import COUPLINGS
from vidphys.coupling_verdict import CANDIDATES, LIMIT, UNEXPLAINED, PowerVerdict, deciding_query
from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.inference.menu import PAIR, field_of
from vidphys.diagnose.inference.search import infer
from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.weak.regression import normal_equations, rows_of


def infer_with_power(motion: Motion, angles: bool) -> tuple[Inference, PowerVerdict | None]:
    """The terms, under the power of the coupling that fits best, and which powers are possible.

    Args:
        motion: tracks, of clips at known couplings or not.
        angles: whether positions are joint angles.
    """
    inference = infer(motion, angles)
    if motion.coupling is None:
        return inference, None
    verdict = which_power(inference, motion.coupling)
    if "linear" in verdict.supported or not (motion.coupling < 0).any():
        return inference, verdict
    tried = {name: infer(motion, angles, name) for name in CANDIDATES if name != "linear"}
    tried["linear"] = inference
    best = min(tried.values(), key=lambda f: (not f.leftover.explained, f.fitted.variance))
    return best, which_power(best, motion.coupling)


def which_power(inference: Inference, coupling: np.ndarray) -> PowerVerdict:
    """Compare powers of the coupling, the shape of the force as it was found.

    Args:
        inference: of clips at known couplings; without a pair force, or with one coupling only,
            there is nothing to compare.
        coupling: of each clip, ``(e,)``.
    """
    if inference.structure.term(PAIR) is None:
        return PowerVerdict((), {}, None, "no pair force was found that a coupling could scale")
    if len(np.unique(coupling)) < 2:
        opposite = -float(coupling[0])
        why = f"one coupling was recorded, every power fits; measure at G = {opposite:.3g}"
        return PowerVerdict(CANDIDATES, {}, opposite, why)
    at = coupling[inference.windows.clip]
    found = {name: _log_likelihood(inference, name, at) for name in CANDIDATES}
    best = max(found, key=lambda name: found[name][0])
    left = {name: value[1] for name, value in found.items()}
    if left[best] > UNEXPLAINED:
        why = f"{left[best]:.0%} of the force follows no power of the coupling"
        return PowerVerdict((), left, None, why)
    # LIMIT standard deviations, as for measured forces, in units of log likelihood.
    near = found[best][0] - 0.5 * LIMIT**2
    supported = tuple(name for name in CANDIDATES if found[name][0] > near)
    if len(supported) == 1:
        return PowerVerdict(supported, left, None, f"only {best} fits every clip")
    query = deciding_query(supported, float(np.median(coupling)))
    advice = "no single coupling parts them" if query is None else f"measure at G = {query:.3g}"
    why = f"{', '.join(supported)} fit equally well; {advice}"
    return PowerVerdict(supported, left, query, why)


def _log_likelihood(inference: Inference, name: str, coupling: np.ndarray) -> tuple[float, float]:
    """Of the structure with pair forces that go with one power, and the share it leaves."""
    windows, structure = inference.windows, inference.structure
    strength = COUPLINGS[name](coupling)
    field = field_of(windows, inference.fitted.paths, strength)
    columns = np.concatenate([term.columns(field) for term in structure.terms], -1)
    ratio = inference.kicks / inference.fitted.variance
    normal = normal_equations(rows_of(windows, columns), ratio)
    chosen = range(columns.shape[-1])
    misfit = normal.misfit(chosen, normal.solve(chosen))
    # Against the noise that differences show: a power's own misfit must not buy it a wider noise.
    variance = max(inference.fitted.variance, inference.noise.sigma**2)
    share = misfit / normal.power if normal.power else 1.0
    return -0.5 * misfit / variance, float(share)
