"""Which power of the coupling do recorded trajectories support, before a counterfactual is asked?

A law that is linear in G and one that is linear in |G| cannot be told apart where G > 0: the test
then abstains, and names the coupling at which one more measurement decides (appendix G).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dynamics import PairLaw, PhaseState, Rollout
from dynamics.powers import COUPLINGS
from vidphys.coupling_verdict import CANDIDATES, LIMIT, UNEXPLAINED, PowerVerdict, deciding_query

SOFTENINGS = (0.1, 0.2, 0.4, 0.8, 1.6)  # world units, of the inverse-square forces fitted
REACHES = (0.25, 0.5, 1.0, 2.0, 4.0)  # world units, of the forces of finite range fitted
FOLDS = 5
RIDGE = 1e-8  # over the mean squared size of a column
WORST = 2.0  # relative error at which a miss is cut off: that of a force with the wrong sign


@dataclass(frozen=True)
class Forces:
    """Measured forces, episode by episode.

    Args:
        state: recorded, ``(b, t, n, d)``.
        force: mean of dp/dt between each state's two neighbours, ``(b, t - 2, n, d)``, mass units
            times world units per second squared.
        coupling: of each episode, ``(b,)``.
        mass: ``(b, n)``.
    """

    state: PhaseState
    force: Tensor
    coupling: Tensor
    mass: Tensor

    def joined(self, other: Forces) -> Forces:
        """These episodes and those of another measurement of equal length."""
        pairs = (
            (self.state.q, other.state.q),
            (self.state.p, other.state.p),
            (self.force, other.force),
            (self.coupling, other.coupling),
            (self.mass, other.mass),
        )
        q, p, force, coupling, mass = (torch.cat(pair) for pair in pairs)
        return Forces(PhaseState(q, p), force, coupling, mass)


def measured_forces(trajectory: Rollout) -> Forces:
    """Forces by differences of the momenta over two intervals each.

    Raises:
        ValueError: fewer than three states, or an episode that is not finite.
    """
    q, p = (x.double() for x in (trajectory.states.q, trajectory.states.p))
    if q.shape[1] < 3:
        raise ValueError(f"measured_forces: needs three states or more, got {q.shape[1]}")
    if not bool(trajectory.finite.all()):
        raise ValueError("measured_forces: an episode is not finite; leave it out")
    force = (p[:, 2:] - p[:, :-2]) / (2 * trajectory.dt)
    params = trajectory.params.map(torch.Tensor.double)
    return Forces(PhaseState(q, p), force, params.coupling, params.mass)


def coupling_power(
    forces: Forces, candidates: Sequence[str] = CANDIDATES, box: float | None = None
) -> PowerVerdict:
    """Compare powers of the coupling by how well each predicts forces of episodes it did not see.

    Each candidate c(G) multiplies the same pair forces, whose shape is fitted; a harmonic
    confinement and a friction that no coupling changes may stand beside them.

    Args:
        forces: see :func:`measured_forces`.
        candidates: of :data:`dynamics.powers.COUPLINGS`.
        box: side of a periodic box in world units.

    Raises:
        ValueError: an unknown candidate, fewer than two episodes, one body alone, or couplings
            that are all zero.
    """
    unknown = [name for name in candidates if name not in COUPLINGS]
    if unknown or not candidates:
        raise ValueError(f"coupling_power: unknown {unknown}; known: {', '.join(COUPLINGS)}")
    if len(forces.coupling) < 2 or forces.mass.shape[-1] < 2:
        raise ValueError("coupling_power: needs two episodes or more, of two bodies or more")
    if not bool((forces.coupling != 0).any()):
        raise ValueError("coupling_power: every coupling is zero; there is no force to compare")
    errors = _held_out_errors(forces, candidates, box)
    unexplained = {name: float(e.mean()) for name, e in errors.items()}
    best = min(unexplained, key=lambda name: unexplained[name])
    if unexplained[best] > UNEXPLAINED:
        share = f"{unexplained[best]:.0%}"
        return PowerVerdict((), unexplained, None, f"{share} of the force is not that of pairs")
    supported = tuple(c for c in candidates if _as_good(errors[c], errors[best]))
    if len(supported) == 1:
        return PowerVerdict(supported, unexplained, None, f"only {best} fits every episode")
    query = deciding_query(supported, float(forces.coupling.median()))
    advice = "no single coupling parts them" if query is None else f"measure at G = {query:.3g}"
    why = f"{', '.join(supported)} fit equally well; {advice}"
    return PowerVerdict(supported, unexplained, query, why)


def _as_good(errors: Tensor, best: Tensor) -> bool:
    """Whether errors exceed the best candidate's by no more than those vary between episodes."""
    excess = (errors - best).sum()
    spread = best.std() * len(best) ** 0.5
    rounding = 1e-6 * best.sum()
    return bool(excess <= LIMIT * spread + rounding)


def _held_out_errors(forces: Forces, names: Sequence[str], box: float | None) -> dict[str, Tensor]:
    """Weighted squared error of each episode's forces, predicted from other episodes, ``(b,)``."""
    size = forces.force.norm(dim=-1, keepdim=True)
    # Relative errors: a few encounters must not outweigh all the rest.
    weight = 1 / (size.square() + size.median().square()).sqrt()
    columns = (_window_mean(x) * weight.unsqueeze(-1) for x in _columns(forces, box))
    pairs, free = (x.flatten(1, 3) for x in columns)
    target = (forces.force * weight).flatten(1)
    scale = target.square().mean()
    errors = {}
    for name in names:
        strength = COUPLINGS[name](forces.coupling)[:, None, None]
        misses = _held_out_misses(torch.cat([strength * pairs, free], -1), target)
        errors[name] = misses.clamp(-WORST, WORST).square().mean(1) / scale
    return errors


def _held_out_misses(x: Tensor, y: Tensor) -> Tensor:
    """Ridge regression of y on x, an episode's residual from a fit without its fold, ``(b, m)``."""
    x = x / x.square().mean((0, 1)).sqrt().clamp_min(torch.finfo(x.dtype).tiny)
    gram, moment = x.mT @ x, (x.mT @ y.unsqueeze(-1)).squeeze(-1)
    damping = RIDGE * x.shape[0] * x.shape[1] * torch.eye(x.shape[2], dtype=x.dtype)
    fold = torch.arange(len(x)) % min(FOLDS, len(x))
    misses = torch.empty_like(y)
    for index in range(int(fold.max()) + 1):
        out = fold == index
        normal, right = gram.sum(0) - gram[out].sum(0), moment.sum(0) - moment[out].sum(0)
        misses[out] = x[out] @ torch.linalg.solve(normal + damping, right) - y[out]
    return misses


def _window_mean(x: Tensor) -> Tensor:
    """Mean over two intervals by Simpson's rule, ``(b, t, ...) -> (b, t - 2, ...)``.

    The measured force is such a mean too; in an encounter it is far from the force in the middle.
    """
    return (x[:, :-2] + 4 * x[:, 1:-1] + x[:, 2:]) / 6


def _columns(forces: Forces, box: float | None) -> tuple[Tensor, Tensor]:
    """What forces may be made of, ``(b, t, n, d, columns)``: with the coupling, and without."""
    q, law = forces.state.q, PairLaw(box=box)
    apart = law.nearest(q.unsqueeze(-2) - q.unsqueeze(-3))
    squared = apart.square().sum(-1, keepdim=True)
    product = (forces.mass.unsqueeze(-1) * forces.mass.unsqueeze(-2))[:, None, :, :, None]
    pairs = []
    for shape in _shapes(squared):
        pull = -apart * shape
        pairs += [(pull * product).sum(-2), pull.sum(-2)]
    velocity = forces.state.p / forces.mass[:, None, :, None]
    return torch.stack(pairs, -1), torch.stack([-q, -velocity], -1)


def _shapes(squared: Tensor) -> list[Tensor]:
    """Pair forces over the displacement, from its squared length: springs, and two families."""
    near = [(squared + s**2) ** -1.5 for s in SOFTENINGS]
    ranged = [torch.exp(-0.5 * squared / reach**2) for reach in REACHES]
    return [torch.ones_like(squared), *near, *ranged]
