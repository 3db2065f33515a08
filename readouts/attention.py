"""Positions from a feature map: object queries that attend over its cells."""

from __future__ import annotations

import math

import torch
from einops import rearrange
from jaxtyping import Float
from torch import Tensor, nn

from readouts.base import FrameReadout
from readouts.scale import FeatureScale

FREQUENCIES = 6
UNSURE = 0.1  # square root of a distance, normalised image units: what is expected before training
NEAR, FAR = 0.01, 1.0  # normalised image units, of bodies from each other
PRECISE = 0.005  # normalised image units; the distance at which a position is half sure


class AttentionReadout(FrameReadout):
    """N queries cross-attend over the cells of one frame; each gives one body's position.

    The position is the attention-weighted mean of the cell centres plus an offset read from the
    attended features, which is what reaches far below the size of a cell. The place of a cell
    enters its key only: what is read at a cell does not depend on where the cell is.

    Args:
        channels: of the feature map.
        bodies: number of queries.
        width: of queries, keys and values.
        heads: of the attention; must divide ``width``.
        offset: largest offset, normalised image units.
        frames: of the clip that one feature frame stands for. The queries are those of the first
            frame, then of the next; offsets are read anew for each, since what is attended to may
            be the same.

    Raises:
        ValueError: counts that do not divide.

    Example:
        >>> from encoders.features import FeatureMap
        >>> features = FeatureMap(torch.randn(2, 5, 16, 4, 4), (8.0, 8.0), torch.arange(5) / 30)
        >>> positions, sure = AttentionReadout(channels=16, bodies=3, width=32)(features)
        >>> tuple(positions.shape), tuple(sure.shape)  # clips, frames, bodies
        ((2, 5, 3, 2), (2, 5, 3))
    """

    def __init__(
        self,
        channels: int,
        bodies: int,
        width: int = 128,
        heads: int = 4,
        offset: float = 0.1,
        frames: int = 1,
    ) -> None:
        super().__init__()
        for name, part, whole, total in (
            ("heads", heads, "width", width),
            ("frames", frames, "bodies", bodies),
        ):
            if total % part:
                raise ValueError(f"AttentionReadout: {name} = {part} must divide {whole} = {total}")
        self.heads, self.offset, self.frames = heads, offset, frames
        self.scale = FeatureScale(channels)
        self.query = nn.Parameter(torch.randn(bodies, width))
        self.key = nn.Linear(channels, width, bias=False)
        self.place = nn.Linear(4 * FREQUENCIES, width, bias=False)
        self.value = nn.Linear(channels, width)
        self.mix = nn.Parameter(torch.zeros(bodies, heads))
        last = nn.Linear(width // 2, 2 * frames)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.correct = nn.Sequential(nn.Linear(width, width // 2), nn.GELU(), last)
        self.doubt = nn.Sequential(
            nn.Linear(width + 1, width // 2), nn.GELU(), nn.Linear(width // 2, 1), nn.Softplus()
        )

    def fit_scale(self, values: Float[Tensor, "f c h w"]) -> None:
        """Standardise features from now on by the statistics of these."""
        self.scale.fit(values)

    def read(
        self, values: Float[Tensor, "f c h w"], centres: Float[Tensor, "h w 2"]
    ) -> tuple[Float[Tensor, "f n 2"], Float[Tensor, "f n"]]:
        """See :class:`readouts.base.Readout`.

        The confidence is :func:`confidence_at` the distance from the truth that is expected of
        the position, judged by what is attended to and by how near the next body was found: bodies
        that hide each other are read worst.
        """
        position, attended = self.look(values, centres)
        frames = position.unflatten(1, (self.frames, -1)).flatten(0, 1)
        apart = nearest(frames).reshape(*position.shape[:2], 1)
        evidence = torch.cat([attended, apart], -1).detach()
        root = UNSURE * self.doubt(evidence).squeeze(-1)
        return position, confidence_at(root.square())

    def look(
        self, values: Float[Tensor, "f c h w"], centres: Float[Tensor, "h w 2"]
    ) -> tuple[Float[Tensor, "f n 2"], Float[Tensor, "f n width"]]:
        """Positions, and what the query of each attends to.

        Args:
            values: features of frames.
            centres: of the cells, normalised image units.
        """
        tokens = rearrange(values, "f c h w -> f c (h w)").to(self.query.dtype)
        cells = rearrange(centres, "h w d -> (h w) d").to(tokens.dtype)
        attention = self.attend(tokens, cells)
        attended = rearrange(self._values(attention, tokens), "f g n e -> f n (g e)")
        seen = torch.einsum("ng,fgnm->fnm", self.mix.softmax(-1), attention)
        position = seen @ cells + self.offset * torch.tanh(self._offsets(attended))
        return position, attended

    def attend(
        self, tokens: Float[Tensor, "f c m"], cells: Float[Tensor, "m 2"]
    ) -> Float[Tensor, "f g n m"]:
        """Attention of each head and query over the cells; sums to one."""
        each = self.query.shape[-1] // self.heads
        query = rearrange(self.query, "n (g e) -> g n e", g=self.heads) / math.sqrt(each)
        # q . (K x) is (K' q) . x: few queries against many cells, so K, and the scale of the
        # features, are applied to the queries; what is the same for all cells drops out
        wanted = query @ rearrange(self.key.weight, "(g e) c -> g e c", g=self.heads)
        wanted = wanted / self.scale.deviation
        place = rearrange(self.place(_waves(cells)), "m (g e) -> g e m", g=self.heads)
        score = torch.einsum("gnc,fcm->fgnm", wanted, tokens) + query @ place
        return score.softmax(-1)

    def _offsets(self, attended: Tensor) -> Tensor:
        """Of each query, ``(f, n, 2)``, by the network of its frame."""
        read = self.correct(attended).unflatten(-1, (self.frames, 2))
        each = read.unflatten(1, (self.frames, -1))
        return each.diagonal(dim1=1, dim2=3).movedim(-1, 1).flatten(1, 2)

    def _values(self, attention: Tensor, tokens: Tensor) -> Tensor:
        """The attended values; attention sums to one, so averaging first is the same."""
        averaged = self.scale(torch.einsum("fgnm,fcm->fgnc", attention, tokens))
        weight = rearrange(self.value.weight, "(g e) c -> g c e", g=self.heads)
        bias = rearrange(self.value.bias, "(g e) -> g 1 e", g=self.heads)
        return averaged @ weight + bias


def _waves(cells: Float[Tensor, "m 2"]) -> Float[Tensor, "m k"]:
    """Sines and cosines of both coordinates, wavelengths from 4 units down by halves."""
    rate = math.pi / 2 * 2 ** torch.arange(FREQUENCIES, device=cells.device, dtype=cells.dtype)
    phase = (cells[..., None] * rate).flatten(-2)
    return torch.cat([phase.sin(), phase.cos()], -1)


def confidence_at(distance: Tensor) -> Tensor:
    """In (0, 1]: how much a position counts whose error is expected to be ``distance``.

    Args:
        distance: normalised image units, not negative.
    """
    return 1 / (1 + (distance / PRECISE).square())


def distance_at(confidence: Tensor) -> Tensor:
    """The expected distance that a confidence stands for; undoes :func:`confidence_at`."""
    return PRECISE * (1 / confidence - 1).clamp_min(0).sqrt()


def nearest(position: Float[Tensor, "f n 2"]) -> Float[Tensor, "f n 1"]:
    """Logarithm of the distance to the nearest other position; as of far ones for a single one."""
    apart = torch.cdist(position, position)
    apart = apart + FAR * torch.eye(position.shape[1], device=position.device)
    return apart.amin(-1, keepdim=True).clamp(NEAR, FAR).log()
