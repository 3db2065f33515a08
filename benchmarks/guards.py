"""What it costs that a rollout is never silently wrong: with all checks, against its bare steps."""

from __future__ import annotations

from functools import partial
from typing import Any

import torch

from benchmarks.contenders import DT, episodes, fitted
from benchmarks.match import Contender, Match
from dynamics import rollout, terms
from vidphys.scenes.gravity import gravity

LEAST = 1 / 1.03  # of the bare steps' speed
WIDTH, STEPS = 64, 2000  # the study's
LEAPS = "leapfrog steps, every state stored, float32"
CHECKED = f"{LEAPS}; all checks of a rollout"


def guards(name: str, count: int) -> Match:
    """Near-circular episodes at the study's step, which no check has a word to say of."""
    head: Any = gravity().law if name == "exact" else fitted(terms.Displacement(width=WIDTH))
    start, params = episodes(count)
    if name != "exact":
        head.see(gravity().simulate(start, params, STEPS).states)

    def bare() -> Any:
        with torch.no_grad():
            return head.trajectory(start, params, STEPS, DT)

    def guarded() -> Any:
        return rollout(head, start, params, STEPS, DT)

    amount, path = count * STEPS, bare().backend
    peers = {"the same steps without guards": (Contender(bare, amount, path, LEAPS), LEAST)}
    row = f"guards, {name}, {count} episode{'s' if count > 1 else ''}"
    return Match(row, "episode-steps", Contender(guarded, amount, path, CHECKED), peers)


guards_exact_1 = partial(guards, "exact", 1)
guards_exact_64 = partial(guards, "exact", 64)
guards_factored_1 = partial(guards, "factored", 1)
guards_factored_64 = partial(guards, "factored", 64)
