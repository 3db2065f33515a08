"""How far an encoder's features are from those that a readout was trained on."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Generator, Tensor

SEEN, KEPT = 20_000, 1_000  # cells that are looked at, and kept, of a training
AT_ONCE = 16  # frames


@dataclass(frozen=True)
class FeatureMemory:
    """Cells of a training's features that stand for all of them.

    They are a core set by farthest points, and a new cell is as strange as it is far from the
    nearest of them (Roth et al., "Towards total recall in industrial anomaly detection", 2022).

    Args:
        mean, scale: of each channel, ``(c,)``; distances are of standardised features.
        kept: standardised, ``(k, c)``.
    """

    mean: Tensor
    scale: Tensor
    kept: Tensor

    @classmethod
    def of(cls, maps: Iterable[Float[Tensor, "f c h w"]]) -> FeatureMemory:
        """Of some maps, which are looked at once, one after the other.

        Raises:
            ValueError: no maps.
        """
        rng, lots, seen = Generator().manual_seed(0), torch.zeros(0), torch.zeros(0)
        for values in maps:  # each cell draws a lot; the lowest of all are looked at
            cells = values.movedim(1, -1).flatten(0, -2)
            drawn = torch.rand(len(cells), generator=rng)
            few = drawn.argsort()[:SEEN]
            found = cells[few].float()
            lots = torch.cat([lots, drawn[few]])
            seen = torch.cat([seen, found]) if len(seen) else found
            if len(seen) > 2 * SEEN:
                lots, seen = _lowest(lots, seen)
        if not len(seen):
            raise ValueError("`maps`: there are none")
        _, seen = _lowest(lots, seen)
        mean, scale = seen.mean(0), seen.std(0, correction=0)
        scale = scale.clamp_min(1e-3 * float(scale.max().clamp_min(1e-3)))
        return cls(mean, scale, _core((seen - mean) / scale))

    def distance(self, values: Float[Tensor, "f c h w"]) -> Float[Tensor, " f"]:
        """Of the strangest cell of each frame; root mean square over channels."""
        parts = [self._strangest(some) for some in values.split(AT_ONCE)]
        return torch.cat(parts) if parts else torch.zeros(0)

    def _strangest(self, values: Tensor) -> Tensor:
        cells = (values.float().movedim(1, -1) - self.mean) / self.scale
        near = torch.cdist(cells.flatten(0, -2), self.kept).amin(-1)
        return near.reshape(len(values), -1).amax(-1) / len(self.mean) ** 0.5


def _lowest(lots: Tensor, cells: Tensor) -> tuple[Tensor, Tensor]:
    chosen = lots.argsort()[:SEEN]
    return lots[chosen], cells[chosen]


def _core(cells: Tensor) -> Tensor:
    """Each next one is the cell farthest from all before it."""
    chosen, away = [0], (cells - cells[0]).square().sum(-1)
    while len(chosen) < min(KEPT, len(cells)) and float(away.max()) > 0:
        chosen.append(int(away.argmax()))
        away = torch.minimum(away, (cells - cells[chosen[-1]]).square().sum(-1))
    return cells[chosen]
