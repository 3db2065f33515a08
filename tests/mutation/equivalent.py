"""Places that no test can see, because turned round they leave the same results; each with why.

They are run all the same: the mutation test stops with an error where a test does see one of them,
and where one is no longer in the source.
"""

from __future__ import annotations

from tests.mutation.rewrite import Place

# (file, function, expression) -> why no result differs
EQUIVALENT = {
    ("dynamics/couplings.py", "_charge", "params.charge"): (
        "a pair law takes the products of two charges only"
    ),
    ("dynamics/couplings.py", "PairLaw.strength", "amount"): (
        "a pair law takes the products of two amounts only"
    ),
    ("dynamics/neighbours.py", "WithinReach.energy", "self.reach"): (
        "a pair energy is an even function of the displacement"
    ),
    ("dynamics/integrators.py", "tao_gate.energy", "(s.q.square() + 1) * (s.p.square() + 1) / 2"): (
        "the gate takes the energy over that of the start"
    ),
    ("vidphys/scenes/engine.py", "heights", "angles[row]"): (
        "a hanging double pendulum and its mirror image are as high"
    ),
}


def reason_of(file: str, function: str, text: str) -> str | None:
    """Why a place makes no difference, or ``None`` where it must be seen."""
    return EQUIVALENT.get((file, function, text))


def stale(places: list[Place], sources: list[str]) -> list[tuple[str, str, str]]:
    """Entries of these sources that name no place any more."""
    there = {(place.file, place.function, place.text) for place in places}
    return [key for key in EQUIVALENT if key[0].startswith(tuple(sources)) and key not in there]
