"""A mass matrix that depends on the configuration, learned by a Cholesky factor.

With L lower triangular and a positive diagonal, M = L^T L or M^-1 = L L^T is symmetric and positive
definite whatever the network says. Both eliminate the last joint of a chain first, which keeps the
entries of L gentle functions: a chain's last joint has an inertia of its own.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.angles import Harmonics
from dynamics.mlp import MLP

# Of the factor's diagonal; far below it, a step of the optimiser makes velocities without bound.
SMALLEST = 0.1


def _placing(joints: int) -> tuple[Tensor, Tensor]:
    """Where the network's outputs go in L: ``(entries, n * n)``, and which lie on the diagonal."""
    rows, columns = torch.tril_indices(joints, joints, device="cpu")
    place = torch.zeros(len(rows), joints * joints, device="cpu")
    place[torch.arange(len(rows), device="cpu"), rows * joints + columns] = 1.0
    return place, (rows == columns).to(place)


class CholeskyMetric(nn.Module):
    """Kinetic energy with a learned metric: 1/2 p^T M(q)^-1 p = 1/2 v^T M(q) v.

    Vectors are ``(..., n)``: joint angles, momenta and velocities.

    Args:
        joints: number of angles n.
        width, activation: of the network.
        form: whether L gives the ``mass`` matrix M = L^T L (DeLaN, generalised-coordinate HNN) or
            its ``inverse`` L L^T (SymODEN).
    """

    place: Tensor
    diagonal: Tensor

    def __init__(self, joints: int, width: int, activation: str, form: str) -> None:
        super().__init__()
        if form not in ("mass", "inverse"):
            raise ValueError(f"CholeskyMetric: unknown form '{form}'; use mass or inverse")
        self.joints, self.form = joints, form
        self.harmonics = Harmonics(joints)
        place, diagonal = _placing(joints)
        self.network = MLP((self.harmonics.size, width, width, len(place)), activation)
        self.register_buffer("place", place)
        self.register_buffer("diagonal", diagonal)

    def factor(self, q: Float[Tensor, "*b n"]) -> Float[Tensor, "*b n n"]:
        """L, lower triangular, ``(..., n, n)``."""
        return self._positive(self.network(self.harmonics(q)))

    def velocity(self, q: Float[Tensor, "*b n"], p: Float[Tensor, "*b n"]) -> Float[Tensor, "*b n"]:
        """M(q)^-1 p."""
        return self._apply_inverse(self.factor(q), p)

    def momentum(self, q: Float[Tensor, "*b n"], v: Float[Tensor, "*b n"]) -> Float[Tensor, "*b n"]:
        """M(q) v."""
        factor = self.factor(q)
        if self.form == "inverse":
            return _upper_solution(factor, _lower_solution(factor, v))
        return _upper(factor, _lower(factor, v))

    def inverse(self, q: Float[Tensor, "*b n"]) -> Float[Tensor, "*b n n"]:
        """M(q)^-1, ``(..., n, n)``."""
        factor = self.factor(q)
        units = torch.eye(self.joints, dtype=q.dtype, device=q.device)
        columns = [self._apply_inverse(factor, unit.expand_as(q)) for unit in units]
        return torch.stack(columns, -1)

    def _apply_inverse(self, factor: Tensor, p: Tensor) -> Tensor:
        if self.form == "inverse":
            return _lower(factor, _upper(factor, p))
        return _lower_solution(factor, _upper_solution(factor, p))

    def hamilton(
        self, q: Float[Tensor, "*b n"], p: Float[Tensor, "*b n"]
    ) -> tuple[Float[Tensor, "*b n"], Float[Tensor, "*b n"]]:
        """The velocity M^-1 p, and -d/dq of 1/2 p^T M(q)^-1 p."""
        features = self.harmonics(q)
        raw = self.network(features)
        factor = self._positive(raw)
        v = self._apply_inverse(factor, p)
        if self.form == "inverse":
            # 1/2 |L^T p|^2, whose derivative in L_ij is p_i (L^T p)_j.
            return v, -self._slope(q, features, raw, p, _upper(factor, p))
        # 1/2 |L v|^2 at fixed v; d(M^-1) = -M^-1 dM M^-1 turns the sign.
        return v, self._slope(q, features, raw, _lower(factor, v), v)

    def coriolis(self, q: Float[Tensor, "*b n"], v: Float[Tensor, "*b n"]) -> Float[Tensor, "*b n"]:
        """d/dq of 1/2 v^T M(q) v at fixed v, less dM/dt v: what bends a free motion.

        Raises:
            ValueError: the metric is one of the inverse.
        """
        if self.form == "inverse":
            raise ValueError("CholeskyMetric: Euler-Lagrange equations need the form 'mass'")
        features = self.harmonics(q)
        raw = self.network(features)
        factor = self._positive(raw)
        rate = self.network.pushforward(features, self.harmonics.pushforward(q, v))
        moved = self._matrix(rate * self._gain(raw))
        turned = _upper(moved, _lower(factor, v)) + _upper(factor, _lower(moved, v))
        return self._slope(q, features, raw, _lower(factor, v), v) - turned

    def _slope(
        self, q: Tensor, features: Tensor, raw: Tensor, row: Tensor, column: Tensor
    ) -> Tensor:
        """Gradient in q of sum_ij L_ij(q) row_i column_j."""
        outer = row.unsqueeze(-1) * column.unsqueeze(-2)
        entries = outer.flatten(-2) @ self.place.T * self._gain(raw)
        return self.harmonics.pullback(q, self.network.gradient(features, entries))

    def _positive(self, raw: Tensor) -> Tensor:
        bent = torch.where(self.diagonal > 0, nn.functional.softplus(raw) + SMALLEST, raw)
        return self._matrix(bent)

    def _gain(self, raw: Tensor) -> Tensor:
        """Slope of the bend that makes the diagonal positive."""
        return torch.where(self.diagonal > 0, torch.sigmoid(raw), torch.ones_like(raw))

    def _matrix(self, entries: Tensor) -> Tensor:
        return (entries @ self.place).unflatten(-1, (self.joints, self.joints))


def _lower(factor: Tensor, x: Tensor) -> Tensor:
    """L x."""
    return (factor * x.unsqueeze(-2)).sum(-1)


def _upper(factor: Tensor, x: Tensor) -> Tensor:
    """L^T x."""
    return (factor * x.unsqueeze(-1)).sum(-2)


def _lower_solution(factor: Tensor, x: Tensor) -> Tensor:
    """L^-1 x by forward substitution, written out for few joints."""
    found: list[Tensor] = []
    for i in range(x.shape[-1]):
        known = sum(
            (factor[..., i, j] * y for j, y in enumerate(found)), torch.zeros_like(x[..., i])
        )
        found.append((x[..., i] - known) / factor[..., i, i])
    return torch.stack(found, -1)


def _upper_solution(factor: Tensor, x: Tensor) -> Tensor:
    """L^-T x by back substitution."""
    backwards = factor.mT.flip(-1, -2)
    return _lower_solution(backwards, x.flip(-1)).flip(-1)
