"""The palette tracker: bodies of known colours, followed through occlusion.

Colours say who is who, so there is nothing to match. Each frame is unmixed into what is visible
of each body; a disk is fitted to that, hidden parts left out; and where little of a body can be
seen, a smooth path through the frames around it says where it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from binders.tracks import Tracks

TINY = 1e-9

Coverage = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class PaletteSettings:
    """Of the fits of disks, and of the paths through them.

    Args:
        frames: of a local path, an odd number.
        degree: of its polynomial.
        passes: of re-weighting it.
        outlier: world units from the path at which a frame's say is halved.
        half: visible share at which a frame's own fit and the path count alike.
        rounds: of Levenberg-Marquardt.
        first_damping: of that.
        explained: part of a colour's light that a disk must explain for it to be one.
        least_pixels: of light; a disk of less has no place within its pixel.
        faint: visible share below which a frame says nothing about a body.
        in_order: whether bodies are known to stand nearer the earlier they are in the palette;
            else a pixel is as much of a body as the others leave of it.
    """

    frames: int = 7
    degree: int = 3
    passes: int = 4
    outlier: float = 0.05
    half: float = 0.05
    rounds: int = 15
    first_damping: float = 1e-3
    explained: float = 0.5
    least_pixels: float = 2.0
    faint: float = 0.02
    in_order: bool = True


def track_by_palette(
    frames: Float[Tensor, "b t 3 H W"],
    times: Float[Tensor, " t"],
    palette: Sequence[tuple[float, float, float]],
    coverage: Coverage,
    xs: Float[Tensor, " W"],
    ys: Float[Tensor, " H"],
    settings: PaletteSettings = PaletteSettings(),
) -> Tracks:
    """Follow one disk of each colour, nearer bodies first in the palette.

    Args:
        frames: colours in [0, 1] over black; body i hides those after it.
        times: seconds of each frame.
        palette: (r, g, b) of each body; at most three, no one a mixture of the others.
        coverage: light of one body at a squared distance (world units squared) from its centre,
            differentiable.
        xs, ys: world coordinates of the pixels' columns and rows.

    Returns:
        Positions in world units. A frame's confidence in a body is the visible share of its light.

    Raises:
        ValueError: colours that cannot be told apart, or a pixel that is not finite.

    Example:
        >>> light = lambda squared: torch.sigmoid((0.16 - squared) / 0.04)
        >>> ys = torch.linspace(2, -2, 33)
        >>> frames = light((-ys - 0.5) ** 2 + ys[:, None] ** 2).expand(1, 3, 1, 33, 33)
        >>> red = torch.tensor([1.0, 0.0, 0.0])[:, None, None]
        >>> times, colours = torch.arange(3.0), [(1.0, 0.0, 0.0)]
        >>> tracks = track_by_palette(frames * red, times, colours, light, -ys, ys)
        >>> [round(x, 3) for x in tracks.positions[0, 0, 0].tolist()]
        [0.5, 0.0]
    """
    if not bool(torch.isfinite(frames).all()):
        clip, frame = torch.nonzero(~torch.isfinite(frames))[0, :2].tolist()
        raise ValueError(f"palette: clip {clip}, frame {frame} has a pixel that is not finite")
    visible = unmix(frames, palette)
    # what the nearer bodies leave of each pixel, or all others
    covered = visible.cumsum(-3) if settings.in_order else visible.sum(-3, keepdim=True)
    clear = 1 - (covered - visible)
    seen = _Seen(visible, clear.clamp(0, 1), coverage, xs.to(frames), ys.to(frames))
    positions, share = seen.locate(settings)
    paths = local_paths(positions.double(), share.double(), times.double(), settings)
    sure = (share.square() / (share.square() + settings.half**2)).unsqueeze(-1)
    return Tracks(sure * positions + (1 - sure) * paths.to(positions), share, times)


def unmix(
    frames: Float[Tensor, "*b 3 H W"], palette: Sequence[tuple[float, float, float]]
) -> Float[Tensor, "*b n H W"]:
    """How much of each colour is in each pixel, by least squares, at least 0 and at most 1.

    Raises:
        ValueError: a colour is black or a mixture of others, so that shares are not unique.
    """
    colours = frames.new_tensor(list(palette)).reshape(-1, 3)
    rank = int(torch.linalg.matrix_rank(colours)) if len(colours) else 0
    if rank < len(colours):
        raise ValueError(
            f"palette: {len(colours)} colours of which only {rank} are independent; three "
            "channels tell at most three bodies apart"
        )
    inverse = torch.linalg.pinv(colours)
    return torch.einsum("...chw,cn->...nhw", frames, inverse).clamp(0, 1)


class _Seen:
    """The visible light of each body, ``(..., n, H, W)``, and the fit of a disk to it."""

    def __init__(
        self, visible: Tensor, clear: Tensor, coverage: Coverage, xs: Tensor, ys: Tensor
    ) -> None:
        self.visible, self.clear, self.coverage = visible, clear, coverage
        self.xs, self.ys = xs, ys

    def locate(self, how: PaletteSettings) -> tuple[Tensor, Tensor]:
        """Positions ``(..., n, 2)`` by Levenberg-Marquardt from the centroids, and visible shares.

        The share is 0 for a body of which no light is left, and where the light is not a disk's;
        its position is then 0.
        """
        q, light = self._centroids()
        damping = torch.full_like(light, how.first_damping)
        residual, dx, dy = self._linear(q)
        cost = residual.square().sum((-2, -1))
        for _ in range(how.rounds):
            trial = q + _step(residual, dx, dy, damping)
            found = self._linear(trial)
            new = found[0].square().sum((-2, -1))
            better = new <= cost
            q = torch.where(better.unsqueeze(-1), trial, q)
            cost = torch.where(better, new, cost)
            damping = torch.where(better, damping / 10, damping * 10)
            residual, dx, dy = (
                torch.where(better[..., None, None], a, b)
                for a, b in zip(found, (residual, dx, dy), strict=True)
            )
        whole = self.coverage(self._squared(q)).sum((-2, -1)).clamp_min(TINY)
        share = (light / whole).clamp(0, 1)
        explained = 1 - cost / self.visible.square().sum((-2, -1)).clamp_min(TINY)
        seen = (share > how.faint) & (explained > how.explained) & (whole > how.least_pixels)
        share = torch.where(seen, share, 0)
        return torch.where(share.unsqueeze(-1) > 0, q, 0), share

    def _centroids(self) -> tuple[Tensor, Tensor]:
        light = self.visible.sum((-2, -1))
        x = (self.visible.sum(-2) * self.xs).sum(-1)
        y = (self.visible.sum(-1) * self.ys).sum(-1)
        return torch.stack([x, y], -1) / light.clamp_min(TINY).unsqueeze(-1), light

    def _squared(self, q: Tensor) -> Tensor:
        dx, dy = self.xs - q[..., :1], self.ys - q[..., 1:]
        return dy.square().unsqueeze(-1) + dx.square().unsqueeze(-2)

    def _linear(self, q: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Residual of the visible light, and the model's derivatives along x and y."""
        squared = self._squared(q)
        with torch.enable_grad():
            free = squared.detach().requires_grad_()
            light = self.coverage(free)
            (slope,) = torch.autograd.grad(light.sum(), free)
        slope = -2 * self.clear * slope
        dx = slope * (self.xs - q[..., :1]).unsqueeze(-2)
        dy = slope * (self.ys - q[..., 1:]).unsqueeze(-1)
        return self.visible - self.clear * light.detach(), dx, dy


def _step(residual: Tensor, dx: Tensor, dy: Tensor, damping: Tensor) -> Tensor:
    """The damped Gauss-Newton step of each body."""

    def dot(a: Tensor, b: Tensor) -> Tensor:
        return (a * b).sum((-2, -1))

    xx, yy, xy = dot(dx, dx), dot(dy, dy), dot(dx, dy)
    xx, yy = xx * (1 + damping) + TINY, yy * (1 + damping) + TINY
    bx, by = dot(dx, residual), dot(dy, residual)
    determinant = xx * yy - xy * xy
    return torch.stack([yy * bx - xy * by, xx * by - xy * bx], -1) / determinant.unsqueeze(-1)


def local_paths(
    positions: Float[Tensor, "b t n 2"],
    weight: Float[Tensor, "b t n"],
    times: Float[Tensor, " t"],
    settings: PaletteSettings = PaletteSettings(),
) -> Float[Tensor, "b t n 2"]:
    """At each frame, the value of a polynomial fitted to the frames around it.

    Frames count by their weight, and less the farther they lie from the path (Cauchy), so that
    one wrong frame does not bend it. Near the ends of a clip the window is cut short.

    Args:
        positions: world units; a frame of weight 0 is not looked at.
        weight: in [0, 1].
        times: seconds.
    """
    half, times = settings.frames // 2, times.to(positions.device)
    orders = torch.arange(settings.degree + 1, device=positions.device)
    paths = []
    for frame in range(len(times)):
        window = slice(max(0, frame - half), frame + half + 1)
        scale = (times[window] - times[frame]).abs().max().clamp_min(TINY)
        powers = ((times[window] - times[frame]) / scale).unsqueeze(-1) ** orders
        paths.append(_path(powers, positions[:, window], weight[:, window], settings))
    return torch.stack(paths, 1)


def _path(powers: Tensor, q: Tensor, weight: Tensor, how: PaletteSettings) -> Tensor:
    """The constant term of the robust polynomial through ``(b, w, n, 2)``, ``(b, n, 2)``."""
    ridge = 1e-6 * torch.eye(how.degree + 1, dtype=q.dtype, device=q.device)
    trust = weight
    for _ in range(how.passes):
        weighted = trust.movedim(1, -1).unsqueeze(-1) * powers  # (b, n, w, degree + 1)
        normal = weighted.mT @ powers + ridge
        terms = torch.linalg.solve(normal, weighted.mT @ q.movedim(1, 2))
        miss = (q - (powers @ terms).movedim(2, 1)).square().sum(-1)
        trust = weight / (1 + miss / how.outlier**2)
    return terms[..., 0, :]
