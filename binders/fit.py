"""Fit of body centres to pixels: the light of equal bodies on a grid, and Levenberg-Marquardt."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

Coverage = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class LightSettings:
    """Of the grid that light is compared on, and of the fit.

    Args:
        lit: part of a body's peak light below which it counts as dark.
        per_reach: samples within a body's reach; with two, one frame in a thousand goes wrong.
        steps: of Levenberg-Marquardt; most frames need five.
        settled: a step below this part of a body's reach ends the fit.
        stuck: so does damping above this.
        ridge: added to the normal matrix: bodies that leave no light do not move.
    """

    lit: float = 0.01
    per_reach: int = 3
    steps: int = 30
    settled: float = 1e-4
    stuck: float = 1e3
    ridge: float = 1e-3


@dataclass(frozen=True)
class Light:
    """Equal, isotropic bodies whose light is 1 - prod(1 - coverage), on a pixel grid.

    Args:
        coverage: light of one body at a squared distance (world units squared) from its centre.
        xs: world x of each column, ``(w,)``.
        ys: world y of each row, ``(h,)``.
        reach: world units from a body's centre beyond which its light is lost in the noise.
        stride: pixels of the frame between samples of the grid.
    """

    coverage: Coverage
    xs: Float[Tensor, " w"]
    ys: Float[Tensor, " h"]
    reach: float
    stride: int = 1
    settings: LightSettings = LightSettings()

    @classmethod
    def on_grid(
        cls,
        coverage: Coverage,
        xs: Float[Tensor, " W"],
        ys: Float[Tensor, " H"],
        settings: LightSettings = LightSettings(),
    ) -> Light:
        """On every ``stride``-th pixel of a frame, as sparsely as the size of a body allows."""
        reach = _reach(coverage, xs, ys, settings.lit)
        stride = max(1, int(reach / settings.per_reach / spacing(xs, ys)))
        return cls(coverage, xs[::stride], ys[::stride], reach, stride, settings)

    def sampled(self, frames: Float[Tensor, "*b H W"]) -> Float[Tensor, "*b h w"]:
        """The frames on this grid."""
        return frames[..., :: self.stride, :: self.stride]

    def dark(self, q: Float[Tensor, "k n 2"]) -> Float[Tensor, "k h w"]:
        """What the bodies leave dark: 1 - the frame that they make."""
        return (1 - self.each(q)).prod(1)

    def each(self, q: Float[Tensor, "k n 2"]) -> Float[Tensor, "k n h w"]:
        """The light of each body on its own."""
        return self.coverage(self._squared(q))

    def _squared(self, q: Tensor) -> Tensor:
        dx, dy = self.xs - q[..., 0:1], self.ys - q[..., 1:2]
        return dy.square().unsqueeze(-1) + dx.square().unsqueeze(-2)

    def normal(self, q: Float[Tensor, "k n 2"], target: Float[Tensor, "k h w"]) -> Normal:
        """The residual at ``q`` and its normal equations, from the closed form of the light."""
        with torch.enable_grad():
            squared = self._squared(q.detach()).requires_grad_()
            covered = self.coverage(squared)
            (slope,) = torch.autograd.grad(covered.sum(), squared)
        dark, others = _products(1 - covered.detach())
        # d light / d centre = (dark of the others) * coverage' * d r^2 / d centre
        slope = -2 * slope * others
        dx, dy = self.xs - q[..., 0:1], self.ys - q[..., 1:2]
        columns = torch.stack([slope * dx.unsqueeze(-2), slope * dy.unsqueeze(-1)], dim=2)
        jacobian = columns.flatten(3).flatten(1, 2)
        residual = (target - 1 + dark).flatten(1)
        return Normal(
            residual.square().sum(-1),
            jacobian @ jacobian.transpose(1, 2),
            (jacobian @ residual.unsqueeze(-1)).squeeze(-1),
        )


@dataclass(frozen=True)
class Normal:
    """Normal equations of each frame's fit; unknowns ordered (x_1, y_1, x_2, ...).

    Args:
        error: sum of squared residuals, ``(k,)``.
        matrix: J^T J, ``(k, 2n, 2n)``.
        gradient: J^T residual, ``(k, 2n)``.
    """

    error: Float[Tensor, " k"]
    matrix: Float[Tensor, "k m m"]
    gradient: Float[Tensor, "k m"]

    def take(self, rows: Tensor, other: Normal, chosen: Tensor) -> None:
        """Overwrite ``rows`` by the ``chosen`` rows of ``other``."""
        self.error[rows] = other.error[chosen]
        self.matrix[rows] = other.matrix[chosen]
        self.gradient[rows] = other.gradient[chosen]


def fit(
    light: Light, target: Float[Tensor, "k h w"], q: Float[Tensor, "k n 2"]
) -> tuple[Float[Tensor, "k n 2"], Normal]:
    """Damped Gauss-Newton from ``q``, each frame with its own damping and its own end.

    No body moves farther than half its reach in a step: beyond that its light says nothing.
    """
    how, q, at = light.settings, q.clone(), light.normal(q, target)
    damping = torch.full_like(at.error, 1e-2)
    rows = torch.arange(len(q), device=q.device)
    for _ in range(how.steps if q.shape[1] else 0):
        if not len(rows):
            break
        scale = damping[rows, None] * at.matrix[rows].diagonal(dim1=1, dim2=2) + how.ridge
        step = torch.linalg.solve(at.matrix[rows] + torch.diag_embed(scale), at.gradient[rows])
        step = step.unflatten(-1, (-1, 2))
        longest = step.norm(dim=-1, keepdim=True)
        step = step * (light.reach / 2 / longest.clamp_min(light.reach / 2))
        trial = light.normal(q[rows] + step, target[rows])
        better = trial.error < at.error[rows]
        q[rows[better]] += step[better]
        at.take(rows[better], trial, better)
        damping[rows] *= torch.where(better, 0.2, 5.0)
        settled = step.norm(dim=-1).amax(-1) < how.settled * light.reach
        rows = rows[~settled & (damping[rows] < how.stuck)]
    return q, at


def spacing(xs: Tensor, ys: Tensor) -> float:
    """World units between pixels. A frame of one pixel has none, and any number will do."""
    longer = xs if len(xs) >= len(ys) else ys
    return float((longer[-1] - longer[0]).abs()) / (len(longer) - 1) if len(longer) > 1 else 1.0


def _reach(coverage: Coverage, xs: Tensor, ys: Tensor, lit: float) -> float:
    """The distance, at most the frame's diagonal, beyond which a body counts as dark."""
    pixel = spacing(xs, ys)
    diagonal = pixel * math.hypot(len(xs), len(ys))
    distance = torch.linspace(0, diagonal, 1 + 8 * math.ceil(diagonal / pixel)).to(xs)
    light = coverage(distance.square())
    return max(float(distance[light > lit * light.max()].max()), pixel)


def _products(dark: Float[Tensor, "k n h w"]) -> tuple[Tensor, Tensor]:
    """The product over bodies, and for each body the product over the others (no division)."""
    before, after = [torch.ones_like(dark[:, 0])], [torch.ones_like(dark[:, 0])]
    for i in range(dark.shape[1] - 1):
        before.append(before[-1] * dark[:, i])
        after.append(after[-1] * dark[:, -1 - i])
    others = torch.stack([b * a for b, a in zip(before, reversed(after), strict=True)], dim=1)
    return others[:, 0] * dark[:, 0], others
