"""The hand-made binder of the study: hard minimum-acceleration matching."""

from __future__ import annotations

from itertools import permutations

import torch
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from binders.tracks import Detections, Tracks

ENUMERATED = 4  # up to 4! = 24 assignments are compared at once; beyond, one clip at a time


def bind_by_acceleration(detections: Detections) -> Tracks:
    """Follow bodies by the assignment of least squared acceleration, frame by frame (the study).

    Detections are given to tracks so that the sum of |d - x - v dt|^2 is least: with even frame
    times that is the squared second difference |d_t+1 - 2 x_t + x_t-1|^2. A track starts at rest,
    so its first step is matched by least displacement. A choice once made stays, which is why
    bodies can be swapped at a close encounter.

    A slot of confidence 0 is no detection. A body left without one goes on with its last velocity,
    at confidence 0. A body that was never seen takes a detection only if the seen ones leave one,
    and stands until then where its slot says. A clip of one frame keeps its detections' order.

    Args:
        detections: as many slots in each frame as there are bodies.

    Returns:
        Tracks whose body ``n`` is slot ``n`` of the first frame. Gradients flow through the
        chosen positions, not through the choice.

    Raises:
        ValueError: there is no frame, a detection is not finite, or the times do not rise.

    Example:
        >>> times = torch.arange(4.0)
        >>> left, right = torch.stack([times, times], -1), torch.stack([3 - times, times], -1)
        >>> slots = torch.stack([left, right], 1)
        >>> slots[2] = slots[2].flip(0)  # the detector knows no order
        >>> tracks = bind_by_acceleration(Detections(slots[None], torch.ones(1, 4, 2), times))
        >>> tracks.positions[0, :, 0].tolist()
        [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [3.0, 3.0]]
    """
    _check(detections)
    place, seen = detections.positions[:, 0], detections.confidence[:, 0] > 0
    when, velocity = torch.zeros_like(place[..., :1]), torch.zeros_like(place)
    positions, confidence = [place], [detections.confidence[:, 0]]
    elapsed = (detections.times - detections.times[0]).tolist()
    for frame in range(1, len(elapsed)):
        since = elapsed[frame] - when
        guess = place + velocity * since
        slots, sure = detections.positions[:, frame], detections.confidence[:, frame]
        chosen = assign(guess, seen, slots, sure > 0)
        here = slots.gather(1, chosen.unsqueeze(-1).expand_as(slots))
        sure = sure.gather(1, chosen)
        hit = (sure > 0).unsqueeze(-1)
        known = seen.unsqueeze(-1)
        positions.append(torch.where(known & ~hit, guess, here))
        confidence.append(sure)
        velocity = torch.where(known & hit, (here - place) / since, velocity)
        place, when = torch.where(hit, here, place), torch.where(hit, elapsed[frame], when)
        seen = seen | hit.squeeze(-1)
    return Tracks(torch.stack(positions, 1), torch.stack(confidence, 1), detections.times)


def assign(
    guess: Float[Tensor, "b n 2"],
    seen: Bool[Tensor, "b n"],
    slots: Float[Tensor, "b n 2"],
    found: Bool[Tensor, "b n"],
) -> Int[Tensor, "b n"]:
    """The slot of each body, each slot once, of least summed squared distance from its guess.

    Args:
        guess: where each body should be, world units.
        seen: whether a body has a guess at all.
        slots: positions of the detections, world units.
        found: whether a slot holds a detection.

    Example:
        >>> guess = torch.tensor([[[0.0, 0.0], [1.0, 0.0]]])
        >>> slots = torch.tensor([[[0.9, 0.0], [0.1, 0.0]]])
        >>> every = torch.ones(1, 2, dtype=torch.bool)
        >>> assign(guess, every, slots, every).tolist()
        [[1, 0]]
    """
    cost = torch.cdist(guess.detach().double(), slots.detach().double()).square()
    cost = torch.where(seen.unsqueeze(-1) & found.unsqueeze(-2), cost, 0)
    # a body without a guess may take a detection only where no other choice is left
    dear = 1 + cost.sum((-2, -1), keepdim=True)
    cost = torch.where(~seen.unsqueeze(-1) & found.unsqueeze(-2), dear, cost)
    n = guess.shape[-2]
    if n > ENUMERATED:
        best = [torch.from_numpy(linear_sum_assignment(c)[1]) for c in cost.cpu().numpy()]
        return torch.cat([torch.empty(0, dtype=torch.long), *best]).reshape(-1, n).to(guess.device)
    options = torch.tensor([*permutations(range(n))], device=guess.device, dtype=torch.long)
    total = cost[:, torch.arange(n, device=guess.device), options].sum(-1)
    return options[total.argmin(-1)]


def _check(detections: Detections) -> None:
    if not len(detections.times):
        raise ValueError("bind_by_acceleration: the clips have no frame; pass at least one")
    if not bool((detections.times.diff() > 0).all()):
        raise ValueError("bind_by_acceleration: times (seconds) must rise from frame to frame")
    bad = ~torch.isfinite(detections.positions).all(-1)
    bad |= ~torch.isfinite(detections.confidence)
    if bool(bad.any()):
        clip, frame, slot = torch.nonzero(bad)[0].tolist()
        raise ValueError(
            f"bind_by_acceleration: clip {clip}, frame {frame}, slot {slot} is not finite; "
            "give a slot without a detection position 0 and confidence 0"
        )
