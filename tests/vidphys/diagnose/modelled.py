"""The model that a diagnosis writes, rolled from where the true motion starts."""

from __future__ import annotations

import numpy as np
import torch

from dynamics import Parameters, PhaseState, build, from_config, rollout
from vidphys.diagnose.telling.answered import Answered

FINE = 8  # steps of a frame
FIRST, DEGREE = 8, 6  # frames, and a polynomial, that tell the velocity at the first


def modelled(given: Answered, path: np.ndarray, step: float) -> np.ndarray:
    """Places ``(t, d)`` by the model of an answer, of one body.

    Args:
        given: the answer.
        path: of the body without noise, ``(t, d)``.
        step: seconds between frames.
    """
    assert given.specification is not None
    term = from_config(given.specification["terms"])
    head = build(term, 1, step / FINE, path.shape[1]).double()
    fit = np.polynomial.polynomial.polyfit(step * np.arange(FIRST), path[:FIRST], DEGREE)
    state = PhaseState(*(torch.tensor(x)[None, None] for x in (path[0], fit[1])))
    law = Parameters(torch.ones(1).double(), torch.ones(1, 1).double()).with_scalar("clock", 0.0)
    rolled = rollout(head, state, law, FINE * (len(path) - 1), step / FINE, FINE)
    return rolled.states.q[0, :, 0].detach().numpy()
