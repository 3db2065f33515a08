"""How far what a model foretells from a few frames is from the next ones."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from binders import Tracks
from dynamics import Head, Parameters
from vidphys.placement import suited
from vidphys.shooting.initial_state import ShootingSettings, by_shooting
from vidphys.shooting.step import model_step, roll


def missed(
    head: Head,
    tracks: Tracks,
    params: Parameters,
    interval: float,
    ahead: int,
    slack: float = ShootingSettings.slacks[-1],
) -> Float[Tensor, " b"]:
    """Mean distance between the last frames of some tracks and what is foretold of them.

    Args:
        head: the law.
        tracks: positions ``(b, t, n, d)``; the start is read from all frames but the last
            ``ahead``, three at least.
        params: of each clip.
        interval: seconds between frames.
        ahead: frames that are foretold.
        slack: see :func:`vidphys.shooting.initial_state.choose_slack`.

    Returns:
        In the unit of the positions.
    """
    dt, every = model_step(interval)
    law = params.map(Tensor.float)
    past = Tracks(
        tracks.positions[:, :-ahead].float(),
        tracks.confidence[:, :-ahead].float(),
        tracks.times[:-ahead],
    )
    with torch.no_grad():
        start = by_shooting(head, past, law, interval, slack).map(Tensor.float)
        foretold = roll(head, *suited((start, law), head), ahead, dt, every).q.cpu()
    return (foretold - tracks.positions[:, -ahead:]).norm(dim=-1).mean((1, 2))
