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

CHANNELS = 32  # of the feature map
WIDTH = 72
HEADS = 6
HIDDEN = 408
WAVELENGTHS = 6  # from 4 normalised image units down by halves
FIRST_ROUNDS, LATER_ROUNDS = 4, 2  # of attention, in the first frame of a clip and in the others
CORRECTION = 0.15  # normalised image units a round, of a correction read as 1
NEAREST, FARTHEST = 0.1, 0.6  # normalised image units that heads look around at first
EMPTY = 1e-6  # attention below it is no attention


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
    """Finds and follows any number of bodies in a feature map of 32 channels; 105,728 parameters.

    That is the study's number, which it does not break down. Here: standardising a cell 64, keys
    and values 4,608, places 1,728, background 198, standardising a slot 144, queries 5,184, reaches
    6, gated update 34,128, standardising for the MLP 144, MLP 59,232, correction 146, doubt 73,
    first state 72 and ring 1.
    """

    def __init__(self) -> None:
        super().__init__()
        self.norm_cell = nn.LayerNorm(CHANNELS)
        self.key = nn.Linear(CHANNELS, WIDTH, bias=False)
        self.value = nn.Linear(CHANNELS, WIDTH, bias=False)
        self.place = nn.Linear(4 * WAVELENGTHS, WIDTH, bias=False)
        self.background = nn.Linear(CHANNELS, HEADS)
        self.norm_slot = nn.LayerNorm(WIDTH)
        self.query = nn.Linear(WIDTH, WIDTH, bias=False)
        self.update = nn.GRUCell(WIDTH + 2 * HEADS, WIDTH)
        self.norm_mlp = nn.LayerNorm(WIDTH)
        self.mlp = nn.Sequential(nn.Linear(WIDTH, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, WIDTH))
        self.correct = nn.Linear(WIDTH, 2)
        nn.init.zeros_(self.correct.weight)
        nn.init.zeros_(self.correct.bias)
        self.log_reach = nn.Parameter(torch.linspace(math.log(NEAREST), math.log(FARTHEST), HEADS))
        self.doubt = nn.Linear(WIDTH, 1)
        self.first = nn.Parameter(0.5 * torch.randn(WIDTH))
        self.ring = nn.Parameter(torch.tensor(0.2))

    def start(self, clips: int, bodies: int, turn: float = 0.0) -> Slots:
        """Slots that have seen nothing: alike but for their places, evenly on a ring.

        Args:
            clips, bodies: how many.
            turn: of the ring, radians.
        """
        angle = turn + 2 * math.pi / max(1, bodies) * torch.arange(bodies)
        ring = self.ring * torch.stack([angle.cos(), angle.sin()], -1).to(self.ring)
        state = self.first.expand(clips, bodies, -1)
        return Slots(state, ring.expand(clips, -1, -1))

    def forward(self, features: FeatureMap, slots: Slots) -> list[Found]:
        """Follow slots through the frames of each clip.

        Between frames a slot goes on as it went between the last two.

        Args:
            features: ``CHANNELS`` channels.
            slots: at the first frame, from :meth:`start`; in any order.

        Raises:
            ValueError: another number of channels.
        """
        if features.values.shape[2] != CHANNELS:
            raise ValueError(
                f"SlotAttention: reads {CHANNELS} channels, got {features.values.shape[2]}; "
                "project the features first"
            )
        cells = self.norm_cell(rearrange(features.values, "b t c h w -> t b (h w) c"))
        centres = features.cell_centres().flatten(0, 1).to(cells)
        found: list[Found] = []
        for frame in cells:
            found.append(self.look(frame, centres, slots, LATER_ROUNDS if found else FIRST_ROUNDS))
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
        split = "b m (g e) -> b g e m"
        keys = rearrange(self.key(cells), split, g=HEADS)
        values = rearrange(self.value(cells), split, g=HEADS)
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
        query = rearrange(self.query(self.norm_slot(slots.state)), "b n (g e) -> b g n e", g=HEADS)
        query = query / math.sqrt(query.shape[-1])
        place = rearrange(self.place.weight, "(g e) w -> g e w", g=HEADS)
        wanted = torch.einsum("bgne,gew->bgnw", query, place)
        far = torch.cdist(slots.position, centres.expand(len(keys), -1, -1)).square().unsqueeze(1)
        near = 0.5 * (-2 * self.log_reach).exp()[:, None, None] * far
        score = query @ keys + _seen_from(slots.position, wanted) @ _waves(centres).mT - near
        share = torch.cat([score, background], 2).softmax(2)[:, :, :-1]
        return share / (share.sum(-1, keepdim=True) + EMPTY)

    def _move(
        self, slots: Slots, read: Float[Tensor, "b n e"], away: Float[Tensor, "b n g 2"]
    ) -> Slots:
        seen = torch.cat([read, 4 * away.flatten(-2)], -1)
        state = self.update(seen.flatten(0, 1), slots.state.flatten(0, 1))
        state = state.unflatten(0, slots.state.shape[:2])
        state = state + self.mlp(self.norm_mlp(state))
        there = slots.position + away.mean(-2) + CORRECTION * self.correct(state)
        return Slots(state, there)


def _waves(at: Float[Tensor, "*b 2"]) -> Float[Tensor, "*b w"]:
    """Sines, then cosines, of both coordinates at all wavelengths."""
    rate = math.pi / 2 * 2 ** torch.arange(WAVELENGTHS, device=at.device, dtype=at.dtype)
    phase = (at[..., None] * rate).flatten(-2)
    return torch.cat([phase.sin(), phase.cos()], -1)


def _seen_from(
    position: Float[Tensor, "b n 2"], wanted: Float[Tensor, "b g n w"]
) -> Float[Tensor, "b g n w"]:
    """Weights of waves of (cell - position) as weights of waves of the cell, by angle addition."""
    sin, cos = _waves(position).unsqueeze(1).chunk(2, -1)
    of_sin, of_cos = wanted.chunk(2, -1)
    return torch.cat([of_sin * cos + of_cos * sin, of_cos * cos - of_sin * sin], -1)
