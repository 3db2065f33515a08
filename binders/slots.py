"""The slot-attention binder: slots compete for cells, and go on to the next frame.

Slot attention (Locatello et al., arXiv:2006.15055) with positions: each slot sees cells from where
it stands (Biza et al., arXiv:2302.04973), and the slots of a frame start the next one's (Kipf et
al., arXiv:2111.12594). A round of attention is a learned step of refinement: the slot moves to what
it attends to, and corrects itself by what it read there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from einops import rearrange
from jaxtyping import Float
from torch import Tensor, nn

from encoders.features import FeatureMap

EMPTY = 1e-6  # attention below it is no attention


@dataclass(frozen=True)
class SlotSettings:
    """Of slot attention.

    Args:
        channels: of the feature map.
        width: of a slot, of keys and values.
        heads: of attention; they divide the width.
        hidden: width within the MLP.
        wavelengths: of places, from 4 normalised image units down by halves.
        first_rounds, later_rounds: of attention, in the first frame of a clip and in the others.
        correction: normalised image units a round, of a correction read as 1.
        nearest, farthest: normalised image units that heads look around at first.
    """

    channels: int = 32
    width: int = 72
    heads: int = 6
    hidden: int = 408
    wavelengths: int = 6
    first_rounds: int = 4
    later_rounds: int = 2
    correction: float = 0.15
    nearest: float = 0.1
    farthest: float = 0.6


@dataclass(frozen=True)
class Slots:
    """What is carried from round to round and from frame to frame.

    Args:
        state: of each slot.
        position: normalised image units.
    """

    state: Float[Tensor, "b n e"]
    position: Float[Tensor, "b n 2"]


@dataclass(frozen=True)
class Found:
    """Where slots were after each round of one frame, and the slots as the last round left them.

    Args:
        rounds: positions, normalised image units.
        doubt: what each slot expects of its own error, on the scale that it was trained on.
        slots: after the last round.
    """

    rounds: Float[Tensor, "b r n 2"]
    doubt: Float[Tensor, "b n"]
    slots: Slots


class SlotAttention(nn.Module):
    """Finds and follows any number of bodies in a feature map; 105,728 parameters by default.

    That is the study's number, which it does not break down. Here: standardising a cell 64, keys
    and values 4,608, places 1,728, background 198, standardising a slot 144, queries 5,184, reaches
    6, gated update 34,128, standardising for the MLP 144, MLP 59,232, correction 146, doubt 73,
    first state 72 and ring 1.
    """

    def __init__(self, settings: SlotSettings = SlotSettings()) -> None:
        super().__init__()
        self.settings = settings
        channels, width, heads = settings.channels, settings.width, settings.heads
        hidden, around = settings.hidden, (math.log(settings.nearest), math.log(settings.farthest))
        self.norm_cell = nn.LayerNorm(channels)
        self.key = nn.Linear(channels, width, bias=False)
        self.value = nn.Linear(channels, width, bias=False)
        self.place = nn.Linear(4 * settings.wavelengths, width, bias=False)
        self.background = nn.Linear(channels, heads)
        self.norm_slot = nn.LayerNorm(width)
        self.query = nn.Linear(width, width, bias=False)
        self.update = nn.GRUCell(width + 2 * heads, width)
        self.norm_mlp = nn.LayerNorm(width)
        self.mlp = nn.Sequential(nn.Linear(width, hidden), nn.ReLU(), nn.Linear(hidden, width))
        self.correct = nn.Linear(width, 2)
        nn.init.zeros_(self.correct.weight)
        nn.init.zeros_(self.correct.bias)
        self.log_reach = nn.Parameter(torch.linspace(*around, heads))
        self.doubt = nn.Linear(width, 1)
        self.first = nn.Parameter(0.5 * torch.randn(width))
        self.ring = nn.Parameter(torch.tensor(0.2))

    def start(self, clips: int, bodies: int, turn: float = 0.0) -> Slots:
        """Slots that have seen nothing: alike but for their places, evenly on a ring.

        Args:
            clips, bodies: how many.
            turn: of the ring, radians.
        """
        angle = turn + 2 * math.pi / max(1, bodies) * torch.arange(bodies, device=self.ring.device)
        ring = self.ring * torch.stack([angle.cos(), angle.sin()], -1).to(self.ring)
        state = self.first.expand(clips, bodies, -1)
        return Slots(state, ring.expand(clips, -1, -1))

    def forward(self, features: FeatureMap, slots: Slots) -> list[Found]:
        """Follow slots through the frames of each clip.

        Between frames a slot goes on as it went between the last two.

        Args:
            features: as many channels as the settings say.
            slots: at the first frame, from :meth:`start`; in any order.

        Raises:
            ValueError: another number of channels.
        """
        channels, how = self.settings.channels, self.settings
        if features.values.shape[2] != channels:
            raise ValueError(
                f"SlotAttention: reads {channels} channels, got {features.values.shape[2]}; "
                "project the features first"
            )
        cells = self.norm_cell(rearrange(features.values, "b t c h w -> t b (h w) c"))
        centres = features.cell_centres().flatten(0, 1).to(cells)
        found: list[Found] = []
        for frame in cells:
            rounds = how.later_rounds if found else how.first_rounds
            found.append(self.look(frame, centres, slots, rounds))
            slots = found[-1].slots
            if len(found) > 1:
                here, before = (f.slots.position for f in (found[-1], found[-2]))
                slots = Slots(slots.state, 2 * here - before)
        return found

    def look(
        self,
        cells: Float[Tensor, "b m c"],
        centres: Float[Tensor, "m 2"],
        slots: Slots,
        rounds: int,
    ) -> Found:
        """Rounds of attention over one frame.

        Args:
            cells: standardised features.
            centres: of the cells, normalised image units.
            slots: where the search starts.
            rounds: how many.
        """
        split, heads = "b m (g e) -> b g e m", self.settings.heads
        keys = rearrange(self.key(cells), split, g=heads)
        values = rearrange(self.value(cells), split, g=heads)
        background = rearrange(self.background(cells), "b m g -> b g 1 m")
        positions = []
        for _ in range(rounds):
            attention = self.attend(keys, centres, background, slots)
            read = rearrange(attention @ values.mT, "b g n e -> b n (g e)")
            seen = rearrange(attention @ centres, "b g n d -> b n g d")
            away = seen - slots.position.unsqueeze(-2)
            slots = self._move(slots, read, away)
            positions.append(slots.position)
        doubt = self.doubt(slots.state).squeeze(-1)
        return Found(torch.stack(positions, 1), doubt, slots)

    def attend(
        self,
        keys: Float[Tensor, "b g e m"],
        centres: Float[Tensor, "m 2"],
        background: Float[Tensor, "b g 1 m"],
        slots: Slots,
    ) -> Float[Tensor, "b g n m"]:
        """Each slot's attention over the cells, which sums to one.

        First each cell is shared out among the slots and the background, so that what one slot
        explains is lost to the others.
        """
        heads, waves = self.settings.heads, self.settings.wavelengths
        query = rearrange(self.query(self.norm_slot(slots.state)), "b n (g e) -> b g n e", g=heads)
        query = query / math.sqrt(query.shape[-1])
        place = rearrange(self.place.weight, "(g e) w -> g e w", g=heads)
        wanted = torch.einsum("bgne,gew->bgnw", query, place)
        far = torch.cdist(slots.position, centres.expand(len(keys), -1, -1)).square().unsqueeze(1)
        near = 0.5 * (-2 * self.log_reach).exp()[:, None, None] * far
        seen = _seen_from(_waves(slots.position, waves), wanted)
        score = query @ keys + seen @ _waves(centres, waves).mT - near
        share = torch.cat([score, background], 2).softmax(2)[:, :, :-1]
        return share / (share.sum(-1, keepdim=True) + EMPTY)

    def _move(
        self, slots: Slots, read: Float[Tensor, "b n e"], away: Float[Tensor, "b n g 2"]
    ) -> Slots:
        seen = torch.cat([read, 4 * away.flatten(-2)], -1)
        state = self.update(seen.flatten(0, 1), slots.state.flatten(0, 1))
        state = state.unflatten(0, slots.state.shape[:2])
        state = state + self.mlp(self.norm_mlp(state))
        there = slots.position + away.mean(-2) + self.settings.correction * self.correct(state)
        return Slots(state, there)


def _waves(at: Float[Tensor, "*b 2"], wavelengths: int) -> Float[Tensor, "*b w"]:
    """Sines, then cosines, of both coordinates at all wavelengths."""
    rate = math.pi / 2 * 2 ** torch.arange(wavelengths, device=at.device, dtype=at.dtype)
    phase = (at[..., None] * rate).flatten(-2)
    return torch.cat([phase.sin(), phase.cos()], -1)


def _seen_from(
    waves: Float[Tensor, "b n w"], wanted: Float[Tensor, "b g n w"]
) -> Float[Tensor, "b g n w"]:
    """Weights of waves of (cell - position) as weights of waves of the cell, by angle addition.

    Args:
        waves: of the positions.
        wanted: weights.
    """
    sin, cos = waves.unsqueeze(1).chunk(2, -1)
    of_sin, of_cos = wanted.chunk(2, -1)
    return torch.cat([of_sin * cos + of_cos * sin, of_cos * cos - of_sin * sin], -1)
