"""The fixed detector of the anonymous world: finds N equal bodies in each frame, without labels.

Each frame is explained on its own, by analysis through synthesis: a matched filter proposes one
body after another in what the bodies found so far leave unexplained, and a fit of all centres to
the pixels follows each proposal. Frames share nothing, so the order of the bodies in a frame says
nothing about who they are.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from binders.fit import Coverage, Light, LightSettings, Normal, fit, spacing
from binders.tracks import Detections

WORK = 2**20  # pixels times bodies that are fitted together: their working set stays in cache
AFAR = 1e3  # reaches from the origin: where a body that was not found waits, out of every frame

Proposal = Callable[[Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class DetectorSettings:
    """Of the search for bodies.

    Args:
        noise: rms pixel error below which a frame counts as explained; one grey level by default.
        evidence: noise variances by which a body must lower the squared error (5 sigma).
    """

    noise: float = 1 / 255
    evidence: float = 25
    light: LightSettings = LightSettings()


def detect(
    frames: Float[Tensor, "b t 1 H W"],
    times: Float[Tensor, " t"],
    bodies: int,
    coverage: Coverage,
    xs: Float[Tensor, " W"],
    ys: Float[Tensor, " H"],
    settings: DetectorSettings = DetectorSettings(),
) -> Detections:
    """Find the centres of ``bodies`` equal, isotropic bodies in each frame.

    Args:
        frames: light in [0, 1]; where bodies overlap it is 1 - prod(1 - coverage).
        times: seconds of each frame.
        bodies: how many to look for.
        coverage: light of one body at a squared distance (world units squared) from its centre,
            element by element and differentiable.
        xs: world x of each column's centre, evenly spaced.
        ys: world y of each row's centre, spaced as ``xs``.

    Returns:
        Positions in world units, and confidences: the part of the rms error that noise explains,
        times 1 / (1 + (e / E)^2), where e is the body's standard error (it grows when bodies
        coincide) and E a tenth of a body's reach. A body that was not found, because it is out of
        the frame or because there are fewer than asked, has position 0 and confidence 0.

    Raises:
        ValueError: a shape does not fit, a pixel is not finite, or ``bodies`` or ``noise`` is
            out of range.

    Example:
        >>> light = lambda squared: torch.sigmoid((0.16 - squared) / 0.04)
        >>> ys = torch.linspace(2, -2, 33)
        >>> frames = light((-ys - 0.5) ** 2 + ys[:, None] ** 2).expand(1, 1, 1, 33, 33)
        >>> seen = detect(frames, torch.zeros(1), 1, light, -ys, ys)
        >>> [round(x, 3) for x in seen.positions[0, 0, 0].tolist()], float(seen.confidence) > 0.9
        ([0.5, 0.0], True)
    """
    _check(frames, times, bodies, xs, ys, settings.noise)
    search = _Search.on_grid(coverage, xs.to(frames), ys.to(frames), settings)
    samples = search.light.sampled(frames[:, :, 0]).flatten(0, 1)
    chunk = max(1, WORK // max(1, bodies * samples.shape[1:].numel()))
    with torch.no_grad():
        found = [search.explain(part, bodies) for part in samples.split(chunk)]
    positions, confidence = (
        torch.cat(parts).unflatten(0, frames.shape[:2]) for parts in zip(*found, strict=True)
    )
    return Detections(positions, confidence, times)


@dataclass(frozen=True)
class _Search:
    """What is fixed while frames are searched.

    Args:
        light: the model of a frame, on every ``stride``-th pixel.
        template: one body on that grid, odd sides, ``(m, m)``.
        places: the samples, where bodies are proposed; a fit can move them beyond the edge.
    """

    light: Light
    template: Float[Tensor, "m m"]
    places: Float[Tensor, "samples 2"]
    settings: DetectorSettings

    @classmethod
    def on_grid(
        cls, coverage: Coverage, xs: Tensor, ys: Tensor, settings: DetectorSettings
    ) -> _Search:
        """Sample as sparsely as the size of a body allows."""
        light = Light.on_grid(coverage, xs, ys, settings.light)
        step = spacing(xs, ys) * light.stride
        half = math.ceil(light.reach / step)
        offset = step * torch.arange(-half, half + 1).to(xs)
        template = coverage(offset.square() + offset.square().unsqueeze(-1))
        places = torch.cartesian_prod(light.ys, light.xs).flip(-1)
        return cls(light, template, places, settings)

    def explain(
        self, target: Float[Tensor, "k h w"], bodies: int
    ) -> tuple[Float[Tensor, "k n 2"], Float[Tensor, "k n"]]:
        """Positions and confidences of the bodies in each frame."""
        q = torch.full((len(target), bodies, 2), AFAR * self.light.reach).to(target)
        if bodies == 0:
            return q, q[..., 0]
        at = self.light.normal(q, target)
        everywhere = torch.arange(len(target), device=q.device)
        for body in range(bodies):
            self.place(target, q, at, body, everywhere, self.best_place)
        for body in range(bodies):
            unlike = self.misfit(target, at) > self.settings.noise
            unexplained = torch.nonzero(unlike).squeeze(-1)
            self.place(target, q, at, body, unexplained, self.brightest_place)
        return self.verdict(target, q, at)

    def place(
        self, target: Tensor, q: Tensor, at: Normal, body: int, rows: Tensor, propose: Proposal
    ) -> None:
        """Lift ``body`` from the frames ``rows``, put it elsewhere and fit all anew, in place.

        A frame is left as it was unless there is evidence for it.
        """
        trial = q[rows]
        others = torch.cat([trial[:, :body], trial[:, body + 1 :]], dim=1)
        trial[:, body] = propose(target[rows], others)
        trial, there = fit(self.light, target[rows], trial)
        better = there.error < at.error[rows] - self.settings.evidence * self.settings.noise**2
        q[rows[better]] = trial[better]
        at.take(rows[better], there, better)

    def best_place(
        self, target: Float[Tensor, "k h w"], q: Float[Tensor, "k n 2"]
    ) -> Float[Tensor, "k 2"]:
        """The place where one more body lowers the squared error most.

        A body of coverage a adds a * dark to the frame, so it lowers the squared error by
        2 <residual * dark, a> - <dark^2, a^2>: two correlations with the template.
        """
        dark = self.light.dark(q)
        residual = target - 1 + dark
        images = torch.stack([residual * dark, dark.square()], dim=1)
        kernels = torch.stack([2 * self.template, -self.template.square()])
        half = len(self.template) // 2
        gain = torch.nn.functional.conv2d(images, kernels.unsqueeze(0), padding=half)
        return self.places[gain.flatten(1).argmax(-1)]

    def brightest_place(
        self, target: Float[Tensor, "k h w"], q: Float[Tensor, "k n 2"]
    ) -> Float[Tensor, "k 2"]:
        """The sample with most light that the other bodies leave unexplained.

        It lies at the rim of a body that hides behind others, where a whole body fits worst.
        """
        unexplained = target - 1 + self.light.dark(q)
        return self.places[unexplained.flatten(1).argmax(-1)]

    def misfit(self, target: Float[Tensor, "k h w"], at: Normal) -> Float[Tensor, " k"]:
        """Rms pixel error."""
        return (at.error / target.shape[1:].numel()).sqrt()

    def verdict(
        self, target: Tensor, q: Tensor, at: Normal
    ) -> tuple[Float[Tensor, "k n 2"], Float[Tensor, "k n"]]:
        """Confidences, with what was not found at position 0 and confidence 0."""
        noise = self.settings.noise
        rms = self.misfit(target, at).clamp_min(noise).unsqueeze(-1)
        # as if each centre were known to within a reach: the inverse exists without any light
        ridge = (noise / self.light.reach) ** 2
        eye = torch.eye(at.matrix.shape[-1]).to(at.matrix)
        variance = torch.linalg.inv(at.matrix + ridge * eye).diagonal(dim1=1, dim2=2)
        error = rms * variance.unflatten(-1, (-1, 2)).sum(-1).sqrt()
        confidence = noise / rms / (1 + (10 * error / self.light.reach).square())
        lit = self.settings.light.lit * self.template.max()
        found = self.light.each(q).flatten(2).amax(-1) > lit
        return torch.where(found.unsqueeze(-1), q, 0), torch.where(found, confidence, 0)


def _check(
    frames: Tensor, times: Tensor, bodies: int, xs: Tensor, ys: Tensor, noise: float
) -> None:
    want, got = (frames.shape[1], *frames.shape[-2:]), (len(times), len(ys), len(xs))
    if got != want or 0 in want:
        raise ValueError(
            f"detect: times, ys and xs must count the frames, rows and columns {want}, "
            f"at least one of each, got {got}"
        )
    gaps = torch.cat([xs.diff(), ys.diff()]).abs()
    if len(gaps) and float(gaps.max() - gaps.min()) > 1e-3 * float(gaps.max()):
        raise ValueError(
            f"detect: xs and ys must be evenly spaced by one distance, "
            f"got gaps from {float(gaps.min())} to {float(gaps.max())}"
        )
    if bodies < 0 or not noise > 0:
        raise ValueError(
            f"detect: bodies must be at least 0 and noise positive, got {bodies} and {noise}"
        )
    if not bool(torch.isfinite(frames).all()):
        clip, frame = torch.nonzero(~torch.isfinite(frames))[0, :2].tolist()
        raise ValueError(f"detect: clip {clip}, frame {frame} has a pixel that is not finite")
