"""Is a latent a phase space? How nearly canonical is the map from it to the true state.

After SyMetric (Higgins et al., "SyMetric: Measuring the quality of learnt Hamiltonian dynamics
inferred from vision", 2021): a polynomial map f of the latent is fitted to the state; it is
canonical where its Jacobian J obeys J W J^T = c W with the symplectic matrix W. The paper's map is
a Lasso of high degree; here it is least squares of the degree that foretells best.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from dynamics import PhaseState

DEGREES = (1, 2)
LEAST_R2, MOST_DEVIATION = 0.9, 0.05  # with which the paper calls a latent symplectic
FITTED = 0.75  # of the samples that the map is made from; the others choose its degree


@dataclass(frozen=True)
class Symplecticity:
    """How nearly a latent is a phase space.

    Args:
        r2: share of the state's variance that the map explains on samples it did not see.
        deviation: of J W J^T from c W, over c W; root mean square over those samples.
    """

    r2: float
    deviation: float

    @property
    def holds(self) -> bool:
        """Whether the latent is symplectic by the paper's limits."""
        return self.r2 > LEAST_R2 and self.deviation < MOST_DEVIATION


def symplecticity(
    latent: Float[Tensor, "b z"], states: PhaseState, held: Float[Tensor, "c z"], true: PhaseState
) -> Symplecticity:
    """Measure a latent of an even number of entries, positions first, then momenta.

    Args:
        latent, states: what the map is made from, ``(b, 2m)`` and ``(b, n, d)``; many more than
            the (2m)^2 / 2 numbers of a quadratic map of one entry.
        held, true: what it is scored on.

    Raises:
        ValueError: entries that do not pair up, or too few samples.

    Example:
        >>> q, p = torch.randn(2, 400, 1, 1, dtype=torch.float64)
        >>> z = torch.cat([q, 2 * p], -1).squeeze(1)  # canonical up to a scale
        >>> symplecticity(z[:300], PhaseState(q, p)[:300], z[300:], PhaseState(q, p)[300:]).holds
        True
    """
    width = latent.shape[-1]
    if width % 2:
        raise ValueError(f"symplecticity: `latent` has {width} entries; q and p must pair up")
    z, x = latent.double(), states.flat.double()
    fitted = int(FITTED * len(z))
    if fitted <= width * (width + 3) // 2 + 1:
        raise ValueError(
            f"symplecticity: {len(z)} samples are too few for a quadratic map of {width} entries"
        )
    middle, size = z.mean(0), z.std(0).clamp_min(1e-12)

    def weights(degree: int, until: int) -> Tensor:
        seen = _monomials((z[:until] - middle) / size, degree)
        return torch.linalg.lstsq(seen, x[:until], driver="gelsd").solution

    def missed(degree: int) -> float:
        later = _monomials((z[fitted:] - middle) / size, degree) @ weights(degree, fitted)
        return float((later - x[fitted:]).square().mean())

    degree = min(DEGREES, key=missed)
    found = weights(degree, len(z))

    def mapped(one: Tensor) -> Tensor:
        return _monomials((one - middle) / size, degree) @ found

    asked, truth = held.double(), true.flat.double()
    left = (mapped(asked) - truth).square().mean() / truth.var(0, correction=0).mean()
    jacobian = torch.func.vmap(torch.func.jacrev(mapped))(asked)
    brackets = jacobian @ _omega(width) @ jacobian.mT  # Poisson brackets of the mapped state
    omega = _omega(truth.shape[-1])
    scale = (brackets * omega).sum((-2, -1)).mean() / omega.square().sum()
    off = (brackets - scale * omega).square().sum((-2, -1)).mean()
    deviation = (off / (scale * omega).square().sum()).sqrt()
    return Symplecticity(1 - float(left), float(deviation))


def _monomials(z: Tensor, degree: int) -> Tensor:
    """1, each entry, and from degree 2 each product of two, in the last axis."""
    parts = [torch.ones_like(z[..., :1]), z]
    if degree > 1:
        i, j = torch.triu_indices(z.shape[-1], z.shape[-1])
        parts.append(z[..., i] * z[..., j])
    return torch.cat(parts, -1)


def _omega(width: int) -> Tensor:
    half = torch.eye(width // 2, dtype=torch.float64)
    none = torch.zeros_like(half)
    return torch.cat([torch.cat([none, half], 1), torch.cat([-half, none], 1)])
