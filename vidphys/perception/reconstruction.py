"""Learning to see from the renderer alone: which positions, drawn, would give this frame?

A fit of all centres to the pixels starts from the positions that a detector gave. Where it ends in
an explained frame, its end is what the detector should have said; elsewhere the blurred picture
says in which direction light is missing. No label and no other detector is involved.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import torch
from torch import Tensor

from binders import Tracks
from binders.fit import Light, LightSettings, fit
from vidphys.perception.blobs import DrawnWorld
from vidphys.perception.discovered import blur_matrices, blurred
from vidphys.perception.relabel import relabel
from vidphys.placement import CPU


@dataclass(frozen=True)
class TeacherSettings:
    """Of the renderer as a teacher.

    Args:
        explained: rms pixel error below which a frame counts as explained.
        blur: world units, standard deviation: light is felt from half a body away.
        fine: pixels; position errors below it count as squares, above it as their logarithm.
        faint: squared light; pixel errors likewise.
        beside: of a body's reach: where a body that stood wrong is set down by another.
        lost: world units; the error that an unexplained frame counts as.
    """

    explained: float = 6 / 255
    blur: float = 0.75
    fine: float = 0.1
    faint: float = 1e-3
    beside: float = 0.25
    lost: float = 1.0
    light: LightSettings = LightSettings()


@dataclass(frozen=True)
class Explained:
    """Positions that the fit ended at, and in which frames they are to be believed.

    Args:
        positions: world units, ``(m, t, n, 2)``.
        believed: ``(m, t)``.
    """

    positions: Tensor
    believed: Tensor

    def __getitem__(self, index: tuple[slice, slice]) -> Explained:
        """Of some windows and frames."""
        return Explained(self.positions[index], self.believed[index])


def told(positions: Tensor, found: Tensor) -> Explained:
    """Known positions, numbered in each window as what was found there.

    Args:
        positions, found: world units, ``(m, t, n, 2)``.
    """
    m, t, n, _ = positions.shape
    where = positions.device
    known = Tracks(positions, torch.ones(m, t, n, device=where), torch.arange(float(t)))
    believed = torch.ones(m, t, dtype=torch.bool, device=where)
    return Explained(relabel(known, found).positions, believed)


@dataclass(frozen=True)
class Reconstruction:
    """The fixed renderer as a teacher.

    Args:
        world: draws positions.
        light: the same, on the grid of the fit.
    """

    world: DrawnWorld
    light: Light
    settings: TeacherSettings

    @classmethod
    def through(
        cls,
        world: DrawnWorld,
        settings: TeacherSettings = TeacherSettings(),
        device: torch.device | str = CPU,
    ) -> Reconstruction:
        """Of a world's own frames, on a device."""
        xs, ys = world.camera.xs(device=device), world.camera.ys(device=device)
        return cls(world, Light.on_grid(world.coverage, xs, ys, settings.light), settings)

    @property
    def fine(self) -> float:
        """World units: errors below it hardly count."""
        return self.settings.fine * self.world.camera.units_per_pixel

    def explain(self, frames: Tensor, positions: Tensor) -> Explained:
        """Fit positions to the frames, each from where it is.

        A frame that its own positions do not lead to an explanation of is tried again from those
        of an explained neighbour.

        Args:
            frames: in [0, 1], ``(m, t, 1, H, W)``.
            positions: world units, ``(m, t, n, 2)``.
        """
        explained, seen = self.settings.explained, self.light.sampled(frames[:, :, 0])
        shape = seen.shape[:2]
        with torch.no_grad():
            q, error = self._fit(seen.flatten(0, 1), positions.flatten(0, 1))
            q, error = q.unflatten(0, shape), error.unflatten(0, shape)
            for here, there in _neighbours(shape[1]):
                rows = torch.nonzero((error[:, here] > explained) & (error[:, there] < explained))
                rows = rows.squeeze(-1)
                again, better = self._fit(seen[rows, here], q[rows, there])
                kept = better < error[rows, here]
                q[rows[kept], here], error[rows[kept], here] = again[kept], better[kept]
        return Explained(q, error < explained)

    def regrouped(self, frames: Tensor, found: Explained) -> Explained:
        """Explain frames that are not yet by moving one body beside another.

        A fit cannot: between a body that stands where none is and two that pass for one lies a
        dark frame. All pairs are tried, and the best is kept where it explains the frame.

        Args:
            frames: in [0, 1], ``(m, t, 1, H, W)``.
            found: as :meth:`explain` left them.
        """
        clip, frame = torch.nonzero(~found.believed, as_tuple=True)
        seen = self.light.sampled(frames[clip, frame, 0])
        start, explained = found.positions[clip, frame], self.settings.explained
        q, least = start.clone(), torch.full_like(start[:, 0, 0], explained)
        beside = self.light.reach * self.settings.beside * torch.eye(2).to(start)
        for body, other in permutations(range(start.shape[1]), 2):
            for apart in beside:
                moved = start.clone()
                moved[:, body] = start[:, other] + apart
                again, error = self._fit(seen, moved)
                better = error < least
                q[better], least[better] = again[better], error[better]
        positions, believed = found.positions.clone(), found.believed.clone()
        positions[clip, frame], believed[clip, frame] = q, least < explained
        return Explained(positions, believed)

    def _fit(self, seen: Tensor, start: Tensor) -> tuple[Tensor, Tensor]:
        """Positions and rms pixel errors of single frames."""
        q, at = fit(self.light, seen, start)
        return q, (at.error / seen.shape[1:].numel()).sqrt()

    def error(self, positions: Tensor, truth: Explained, frames: Tensor) -> tuple[Tensor, Tensor]:
        """What is wrong with some positions.

        Args:
            positions: world units, ``(m, r, t, n, 2)``; ``r`` for attempts at the same frames.
            truth: of these frames.
            frames: in [0, 1], ``(m, t, 1, H, W)``.

        Returns:
            What is to be minimised, ``(m, r, t, n)``: log(1 + e^2 / fine^2) of each body's error
            where a frame is explained, and elsewhere the same of its blurred pixels; and the
            first of them everywhere, with a frame that is not explained counted as lost.
        """
        far = (positions - truth.positions.unsqueeze(1)).square().sum(-1)
        believed = truth.believed[:, None, :, None]
        apart = (torch.where(believed, far, self.settings.lost**2) / self.fine**2).log1p()
        clip, frame = torch.nonzero(~truth.believed, as_tuple=True)
        rows, columns = blur_matrices(self.world.camera, self.settings.blur)
        drawn = self.world(positions[clip, :, frame])
        light = blurred(drawn - frames[clip, frame].unsqueeze(1), rows, columns)
        faint = self.settings.faint
        dim = (light.square().mean((-3, -2, -1)) / faint).log1p().unsqueeze(-1)
        error = apart.transpose(1, 2).index_put((clip, frame), dim.expand(-1, -1, far.shape[-1]))
        return error.transpose(1, 2), apart.detach()


def _neighbours(frames: int) -> list[tuple[int, int]]:
    """Pairs of a frame and the one before it, in order; then the one after it, backwards."""
    forth = [(at, at - 1) for at in range(1, frames)]
    return forth + [(at, at + 1) for at in reversed(range(frames - 1))]
