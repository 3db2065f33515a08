"""The learned tracker of the study: a small network says which detection continues a track.

Frame by frame each track's next position is predicted, every pair of a prediction and a detection
is scored by the network, and the scores decide who goes where. The decision is soft in training
(Sinkhorn), so that gradients flow. When tracks are read it is one-to-one, and the likeliest few
histories are followed side by side until later frames tell them apart (multiple hypotheses, Reid
1979): at a close encounter the frame itself often does not say who is who, the next ones do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import permutations

import torch
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment
from torch import Tensor, nn

from binders.tracks import Detections, Tracks

ENUMERATED = 4  # up to 4! = 24 assignments are compared at once; beyond, only the best is found
DEAR = 100.0  # more than any score differs: paid where an unseen body takes a detection
HYPOTHESES = 6  # more change nothing at three bodies


@dataclass(frozen=True)
class TrackerSettings:
    """Of the network that scores, and of the soft assignment.

    Args:
        near: world units; features are linear below, logarithmic above.
        width: of the two hidden layers.
        rounds: of Sinkhorn.
    """

    near: float = 0.01
    width: int = 64
    rounds: int = 30


Motion = Callable[[Tensor], Tensor]
"""Where bodies go next: from positions in t even frames, ``(..., t, n, 2)``, to ``(..., n, 2)``."""


def extrapolate(past: Float[Tensor, "*b t n 2"]) -> Float[Tensor, "*b n 2"]:
    """Constant acceleration from three frames on, constant velocity from two, rest from one."""
    last = past.unbind(-3)[-3:]
    if len(last) == 1:
        return last[0]
    if len(last) == 2:
        return 2 * last[1] - last[0]
    return 3 * (last[2] - last[1]) + last[0]


class Tracker(nn.Module):
    """Scores pairs (track, detection) from five features; 4,609 parameters at a width of 64.

    It starts as a sensible matcher: at first the score is exactly -log(1 + d^2 / near^2), where d
    is the distance from the track's predicted position to the detection.
    """

    def __init__(self, settings: TrackerSettings = TrackerSettings()) -> None:
        super().__init__()
        self.settings, width = settings, settings.width
        self.network = nn.Sequential(
            nn.Linear(5, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1)
        )
        first, second, last = (m for m in self.network if isinstance(m, nn.Linear))
        with torch.no_grad():
            for layer, row in ((first, torch.eye(5)[2]), (second, torch.eye(width)[0])):
                layer.weight[0], layer.bias[0] = row, 0.0
            last.weight[0], last.bias[0] = -torch.eye(width)[0], 0.0

    def forward(
        self,
        past: Float[Tensor, "*b t n 2"],
        guess: Float[Tensor, "*b n 2"],
        slots: Float[Tensor, "*b n 2"],
        confidence: Float[Tensor, "*b n"],
    ) -> Float[Tensor, "*b n n"]:
        """Scores of each track (rows) and detection (columns); higher is likelier."""
        features = pair_features(past, guess, slots, confidence, self.settings.near)
        return self.network(features).squeeze(-1)


def pair_features(
    past: Float[Tensor, "*b t n 2"],
    guess: Float[Tensor, "*b n 2"],
    slots: Float[Tensor, "*b n 2"],
    confidence: Float[Tensor, "*b n"],
    near: float = TrackerSettings.near,
) -> Float[Tensor, "*b n n 5"]:
    """What the tracker sees of each track i (rows) and detection j (columns).

    Args:
        past: positions of the tracks in the frames so far, world units.
        guess: predicted positions of the tracks, world units.
        slots: detections, world units.
        confidence: of the detections, in [0, 1].
        near: world units.

    Returns:
        With e = (guess_i - slot_j) / near, the features asinh(e_x), asinh(e_y), log(1 + |e|^2),
        log(1 + |a|^2) and the confidence; a = (d - 2 x_t + x_t-1) / near is the acceleration
        that taking the detection would mean (world units a frame squared, over near). The
        logarithms keep both a tenth of a pixel and the width of the frame in range.
    """
    error = (guess.unsqueeze(-2) - slots.unsqueeze(-3)) / near
    coasting = extrapolate(past[..., -2:, :, :])
    acceleration = (slots.unsqueeze(-3) - coasting.unsqueeze(-2)) / near
    sizes = torch.stack([error.square().sum(-1), acceleration.square().sum(-1)], -1)
    sure = confidence.unsqueeze(-2).expand(error.shape[:-1]).unsqueeze(-1)
    return torch.cat([error.asinh(), sizes.log1p(), sure], -1)


def sinkhorn(
    logits: Float[Tensor, "*b n n"], rounds: int = TrackerSettings.rounds
) -> Float[Tensor, "*b n n"]:
    """The doubly stochastic matrix nearest to exp(logits), by scaling rows and columns in turn."""
    for _ in range(rounds):
        logits = logits - logits.logsumexp(-1, keepdim=True)
        logits = logits - logits.logsumexp(-2, keepdim=True)
    return logits.exp()


@dataclass(frozen=True)
class SoftTracks:
    """Tracks under a soft assignment, differentiable in the tracker's parameters.

    Args:
        positions: expected position of each track, world units.
        variance: of that position under the assignment, world units squared; zero where the
            assignment is one-to-one, or where it cannot matter because detections coincide.
    """

    positions: Float[Tensor, "b t n 2"]
    variance: Float[Tensor, "b t n"]


def follow_softly(
    tracker: Tracker,
    detections: Detections,
    temperature: float = 1.0,
    motion: Motion = extrapolate,
) -> SoftTracks:
    """Tracks that share detections in doubly stochastic parts, for training.

    Gradients flow through the parts that a track is given, not through the predictions.

    Args:
        tracker: gives the scores.
        detections: as many slots in each frame as there are bodies, all found in the first frame.
        temperature: scores are divided by it; towards zero the assignment becomes one-to-one.
        motion: predicts the next frame.
    """
    positions = [detections.positions[:, 0]]
    variance = [torch.zeros_like(detections.confidence[:, 0])]
    for frame in range(1, len(detections.times)):
        slots, confidence = detections.positions[:, frame], detections.confidence[:, frame]
        past = torch.stack(positions[-3:], 1).detach()
        guess, found = motion(past), confidence > 0
        score = torch.where(found.unsqueeze(-2), tracker(past, guess, slots, confidence), 0)
        part = sinkhorn(score / temperature, tracker.settings.rounds).unsqueeze(-1)
        # whoever is given a slot without a detection goes on as predicted
        taken = torch.where(found[:, None, :, None], slots.unsqueeze(-3), guess.unsqueeze(-2))
        here = (part * taken).sum(-2)
        positions.append(here)
        variance.append((part * (taken - here.unsqueeze(-2)).square()).sum((-2, -1)))
    return SoftTracks(torch.stack(positions, 1), torch.stack(variance, 1))


def follow(
    tracker: Tracker,
    detections: Detections,
    motion: Motion = extrapolate,
    hypotheses: int = HYPOTHESES,
) -> tuple[Tracks, Float[Tensor, " b"]]:
    """Tracks by the one-to-one assignments of greatest summed score over the clip.

    A slot of confidence 0 is no detection: who is left without one goes on as predicted, at
    confidence 0. A body not yet seen takes a detection only if the seen ones leave one; until
    then it stands where it will be seen first. Frames must be evenly spaced.

    Args:
        tracker: gives the scores.
        detections: as many slots in each frame as there are bodies.
        motion: predicts the next frame; it is given all hypotheses at once, ``(b, k, t, n, 2)``.
        hypotheses: histories that are kept from frame to frame; with 1, each frame's best
            assignment is final. Beyond four bodies one is kept.

    Returns:
        Tracks whose body ``n`` is slot ``n`` of the first frame, and the summed score of each
        clip, by which tracks under two motions can be compared.

    Raises:
        ValueError: there is no frame, a detection is not finite, the frames are not evenly
            spaced, or ``hypotheses`` is not positive.

    Example:
        >>> times = torch.arange(4.0)
        >>> slots = torch.stack([times, -times], -1)[None, :, :, None].expand(1, 4, 2, 2).clone()
        >>> slots[:, 3] = slots[:, 3].flip(1)
        >>> found, score = follow(Tracker(), Detections(slots, torch.ones(1, 4, 2), times))
        >>> found.positions[0, :, 0, 0].tolist()
        [0.0, -1.0, -2.0, -3.0]
    """
    _check(detections, hypotheses)
    histories = _Histories.begin(detections)
    with torch.no_grad():
        for frame in range(1, len(detections.times)):
            histories = histories.go_on(tracker, detections, frame, motion, hypotheses)
    tracks = Tracks(histories.positions[:, 0], histories.confidence[:, 0], detections.times)
    return tracks, histories.score[:, 0]


@dataclass(frozen=True)
class _Histories:
    """Hypotheses of each clip, best first.

    Args:
        positions, confidence: of the tracks so far.
        score: summed over frames.
    """

    positions: Float[Tensor, "b k t n 2"]
    confidence: Float[Tensor, "b k t n"]
    score: Float[Tensor, "b k"]

    @classmethod
    def begin(cls, detections: Detections) -> _Histories:
        positions, confidence = (
            detections.positions[:, None, :1],
            detections.confidence[:, None, :1],
        )
        return cls(positions, confidence, torch.zeros_like(confidence[:, :, 0].sum(-1)))

    def go_on(
        self, tracker: Tracker, detections: Detections, frame: int, motion: Motion, keep: int
    ) -> _Histories:
        """Every way to go on by one frame; the ``keep`` best of them."""
        slots, confidence = detections.positions[:, frame], detections.confidence[:, frame]
        guess = motion(self.positions)
        each = slots.unsqueeze(1).expand_as(guess), confidence.unsqueeze(1).expand(guess.shape[:-1])
        score = tracker(self.positions, guess, *each)
        score = _gate(score, self.seen, each[1] > 0)
        options = _assignments(score)
        ways = options.shape[2]
        gain = score.unsqueeze(2).expand(-1, -1, ways, -1, -1).gather(-1, options.unsqueeze(-1))
        total = (self.score.unsqueeze(-1) + gain.sum((-2, -1))).flatten(1)
        best, which = total.topk(min(keep, total.shape[1]))
        parent, chosen = which // ways, _pick(options.flatten(1, 2), which)
        kept = _Histories(_pick(self.positions, parent), _pick(self.confidence, parent), best)
        here = _pick(slots, chosen.flatten(1)).reshape(*chosen.shape, 2)
        sure = _pick(confidence, chosen.flatten(1)).reshape(chosen.shape)
        return kept.append(_pick(guess, parent), here, sure)

    @property
    def seen(self) -> Bool[Tensor, "b k n"]:
        """Which bodies have been detected so far."""
        return (self.confidence > 0).any(-2)

    def append(
        self,
        guess: Float[Tensor, "b k n 2"],
        here: Float[Tensor, "b k n 2"],
        sure: Float[Tensor, "b k n"],
    ) -> _Histories:
        """One more frame, given each track's slot; who has an empty one goes where it was guessed.

        A body stands until it is first seen where it is then seen.
        """
        known = self.seen.unsqueeze(-1)
        here = torch.where(known & (sure.unsqueeze(-1) == 0), guess, here)
        past = torch.where(known.unsqueeze(2), self.positions, here.unsqueeze(2))
        positions = torch.cat([past, here.unsqueeze(2)], 2)
        return _Histories(positions, torch.cat([self.confidence, sure.unsqueeze(2)], 2), self.score)


def _pick(x: Tensor, which: Int[Tensor, "b m"]) -> Tensor:
    """Rows ``which`` of ``(b, k, ...)``, clip by clip."""
    clip = torch.arange(len(x), device=x.device).unsqueeze(-1)
    return x[clip, which]


def _gate(
    score: Float[Tensor, "b k n n"], seen: Bool[Tensor, "b k n"], found: Bool[Tensor, "b k n"]
) -> Float[Tensor, "b k n n"]:
    """Nothing is lost or won with a slot that is empty; the unseen wait for the seen."""
    seen, found = seen.unsqueeze(-1), found.unsqueeze(-2)
    return torch.where(seen & found, score, torch.where(~seen & found, -DEAR, 0.0))


def _assignments(score: Float[Tensor, "b k n n"]) -> Int[Tensor, "b k m n"]:
    """The slot of each track, each slot once: all ways for few bodies, else the best one."""
    b, k, n, _ = score.shape
    if n <= ENUMERATED:
        every = torch.tensor([*permutations(range(n))], dtype=torch.long, device=score.device)
        return every.expand(b, k, -1, -1)
    flat = score.flatten(0, 1).double().cpu().numpy()
    best = [torch.from_numpy(linear_sum_assignment(s, maximize=True)[1]) for s in flat]
    return torch.cat([torch.empty(0, dtype=torch.long), *best]).reshape(b, k, 1, n).to(score.device)


def _check(detections: Detections, hypotheses: int) -> None:
    gaps = detections.times.double().diff()
    if not len(detections.times):
        raise ValueError("follow: the clips have no frame; pass at least one")
    if hypotheses < 1:
        raise ValueError(f"follow: needs at least one hypothesis, got {hypotheses}")
    if len(gaps) and not bool((gaps > 0).all() and gaps.max() < 1.01 * gaps.min()):
        raise ValueError(
            "follow: frames must be evenly spaced, rising in time; "
            f"got gaps from {float(gaps.min())} to {float(gaps.max())} seconds"
        )
    bad = ~torch.isfinite(detections.positions).all(-1) | ~torch.isfinite(detections.confidence)
    if bool(bad.any()):
        clip, frame, slot = torch.nonzero(bad)[0].tolist()
        raise ValueError(
            f"follow: clip {clip}, frame {frame}, slot {slot} is not finite; "
            "give a slot without a detection position 0 and confidence 0"
        )
