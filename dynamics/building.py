"""From the terms that a scene has to the model that has exactly those."""

from __future__ import annotations

from dynamics.head import Head
from dynamics.terms import HeadTerm, Sizes


def build(
    term: HeadTerm, bodies: int, dt: float, space: int = 2, conditions: int | None = None
) -> Head:
    """Build the model of a term, randomly initialised from torch's global generator.

    Args:
        term: what the model is made of; see :data:`HEADS` for the study's, by name.
        bodies: number of bodies N >= 1.
        dt: seconds; what one application of a transition map stands for. A Hamiltonian has a
            vector field and may be stepped by any dt.
        space: dimensions of space.
        conditions: entries of the parameters' vector, for networks that are given it; G and the
            masses by default.

    Raises:
        ValueError: no bodies, or a name in the terms that is not known.

    Example:
        >>> from dynamics import HEADS, build
        >>> head = build(HEADS["factored"], bodies=3, dt=0.01)
        >>> parameter_count(head)
        4417
    """
    if bodies < 1:
        raise ValueError(f"build: a model needs at least one body, got bodies = {bodies}")
    given = bodies + 1 if conditions is None else conditions
    return term.build(Sizes(bodies, space, given, dt))


def parameter_count(head: Head) -> int:
    """Number of learned scalars."""
    return sum(p.numel() for p in head.parameters())
