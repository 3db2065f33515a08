"""The finite-time transport bound and the score that it makes, for linear fields.

|x(t) - x*(t)| <= e^{Lt} (|x(0) - x*(0)| + t (content + map)): a wrong start, a wrong content and a
wrong parameter map, each carried by the model's own field. The terms need the truth; the score
ranks models and certifies nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


def generator(stiffness: Tensor) -> Tensor:
    """The field of dq/dt = p, dp/dt = -K q as a matrix, ``(..., n, n) -> (..., 2n, 2n)``."""
    n = stiffness.shape[-1]
    eye = torch.eye(n, dtype=stiffness.dtype).expand_as(stiffness)
    nothing = torch.zeros_like(stiffness)
    top = torch.cat([nothing, eye], -1)
    return torch.cat([top, torch.cat([-stiffness, nothing], -1)], -2)


def flow(field: Tensor, start: Tensor, times: Tensor) -> Tensor:
    """Exact states of dx/dt = A x, ``(..., 2n)`` at times ``(t,)`` -> ``(..., t, 2n)``."""
    carried = torch.linalg.matrix_exp(field.unsqueeze(-3) * times[:, None, None])
    return (carried @ start[..., None, :, None]).squeeze(-1)


@dataclass(frozen=True)
class Transport:
    """The terms of the bound; batch axes ``(...)``.

    Args:
        initial: |x(0) - x*(0)|.
        content: largest field error in the region that learned content makes under the true map.
        map_error: largest field error that the declared map adds.
        lipschitz: of the deployed field, per second.
    """

    initial: Tensor
    content: Tensor
    map_error: Tensor
    lipschitz: Tensor

    def log_score(self, time: Tensor) -> Tensor:
        """Logarithm of the score after ``time`` seconds, which large exponents do not overflow."""
        size = self.initial + time * (self.content + self.map_error)
        return self.lipschitz * time + size.log()


def linear_transport(
    deployed: Tensor, content: Tensor, truth: Tensor, initial: Tensor, radius: Tensor
) -> Transport:
    """The terms for linear fields, exactly, over a ball.

    Args:
        deployed: the model's field at the tested coupling, ``(..., m, m)``, per second.
        content: the learned content under the true map of the coupling.
        truth: the reference field.
        initial: error of the start, ``(...)``.
        radius: of a ball around the origin that holds both trajectories, ``(...)``.
    """

    def largest(field: Tensor) -> Tensor:
        return torch.linalg.matrix_norm(field, 2)

    return Transport(
        initial,
        largest(content - truth) * radius,
        largest(deployed - content) * radius,
        largest(deployed),
    )
