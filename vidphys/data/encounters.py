"""Clips in which bodies meet: paths of other clips, moved so that one body hides another.

Bodies hide each other in few frames of a scene, and there a readout errs most. To say where bodies
are takes no law: paths of different clips, brought together and drawn, teach it as well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from dynamics import PhaseState
from vidphys.data.clips import Clips, pictures


@dataclass(frozen=True)
class EncounterSettings:
    """Of made encounters.

    Args:
        near: normalised image units within which a body is brought of the one that stays.
        alone: share of the other bodies that are left where they are.
    """

    near: float = 0.2
    alone: float = 0.25


def encounters(
    clips: Clips,
    count: int,
    frames: int,
    seed: int,
    settings: EncounterSettings = EncounterSettings(),
) -> Clips:
    """Short clips of bodies that meet, drawn as ``clips`` were.

    Each body moves as it does in a clip of its own, and no law joins them: what can be learned
    here is where bodies are, not how they act on each other.

    Args:
        clips: whose paths are taken; bodies must be in the frame throughout, and stay in it.
        count: of the clips that are made.
        frames: of each; there is one in it at which bodies meet.
        seed: of who meets whom, when and how near.
    """
    rng = Generator().manual_seed(seed)
    b, t, n, _ = clips.states.q.shape
    source = torch.randint(b, (count, n, 1), generator=rng)
    first = torch.randint(t - frames + 1, (count, 1, 1), generator=rng)
    when, body = first + torch.arange(frames), torch.arange(n)[:, None]
    q, p = (x[source, when, body].movedim(1, 2) for x in (clips.states.q, clips.states.p))
    q = q + _moves(q, clips.world.camera.half_extent, rng, settings)[:, None]
    return replace(
        clips,
        frames=pictures(clips.world, q),
        states=PhaseState(q, p),
        params=clips.params[source[:, 0, 0]],
        rejected=0,
    )


def _moves(q: Tensor, half_extent: float, rng: Generator, how: EncounterSettings) -> Tensor:
    """Where each path is moved, ``(b, n, d)`` world units: one body stays, others come near it."""
    b, t, n, _ = q.shape
    clip = torch.arange(b)
    then = q[clip, torch.randint(t, (b,), generator=rng)]
    host = torch.randint(n, (b,), generator=rng)
    angle, apart = torch.rand(2, b, n, 1, generator=rng, dtype=q.dtype)
    turn = 2 * torch.pi * angle
    beside = how.near * half_extent * apart * torch.cat([turn.cos(), turn.sin()], -1)
    moves = then[clip, host][:, None] + beside - then
    moves = moves.clamp(-half_extent - q.amin(1), half_extent - q.amax(1))
    stays = torch.rand(b, n, generator=rng) < how.alone
    stays[clip, host] = True
    return moves.masked_fill(stays[..., None], 0)
