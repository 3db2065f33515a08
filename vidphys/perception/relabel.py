"""Evaluation only: which track is which true body, where the picture does not say."""

from __future__ import annotations

import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from binders import Tracks


def relabel(tracks: Tracks, truth: Tensor) -> Tracks:
    """Give each clip's tracks the numbers of the true bodies, one permutation a clip.

    Of all permutations the one of least summed squared distance is taken; the last frame, where
    a rollout will start, counts as much as the whole clip. Where identity was switched within a
    clip, no permutation hides it. Tracks whose identity is given stay as they are.

    Args:
        tracks: of ``n`` bodies, all finite.
        truth: true positions at the same frames, world units, ``(b, t, n, 2)``.

    Raises:
        ValueError: the shapes differ, or a position is not finite.
    """
    if tracks.positions.shape != truth.shape:
        raise ValueError(
            f"relabel: tracks are {tuple(tracks.positions.shape)} and the truth is "
            f"{tuple(truth.shape)}; both must be (clips, frames, bodies, 2) of the same clips"
        )
    if not bool(torch.isfinite(tracks.positions).all() and torch.isfinite(truth).all()):
        raise ValueError(
            "relabel: tracks and truth must be finite; leave out the clips that are not"
        )
    apart = truth.double().unsqueeze(3) - tracks.positions.detach().double().unsqueeze(2)
    squared = apart.square().sum(-1)
    cost = squared.mean(1) + squared[:, -1]
    order = torch.stack([torch.as_tensor(linear_sum_assignment(c)[1]) for c in cost.cpu().numpy()])
    index = order.to(truth.device)[:, None, :].expand(truth.shape[:-1])
    positions = tracks.positions.gather(2, index.unsqueeze(-1).expand_as(tracks.positions))
    return Tracks(positions, tracks.confidence.gather(2, index), tracks.times)
