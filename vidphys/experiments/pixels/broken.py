"""Clips in which nature errs: from one frame on, a body or all of them break their law.

The pairs are as in tests of intuitive physics (Riochet et al., IntPhys, 2018): a broken clip and
its lawful twin are the same pictures up to the frame at which they part.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from dynamics import Parameters, PhaseState
from vidphys.data.clips import Clips, pictures
from vidphys.scenes import Scene, certify

FAR = 1e3  # world units; where no camera looks
JUMP = 0.75  # world units


@dataclass(frozen=True)
class Breach:
    """How one clip goes on from the state at which it breaks its law.

    Args:
        state: at the break, of all clips, ``(b, n, d)``; the others' order of bodies is random, so
            the first body is any.
        params: the law until then.
    """

    state: PhaseState
    params: Parameters


def _turned(breach: Breach) -> Breach:
    """The first body goes on at right angles to its course."""
    p = breach.state.p.clone()
    p[:, 0] = torch.stack([-p[:, 0, 1], p[:, 0, 0]], -1)
    return replace(breach, state=PhaseState(breach.state.q, p))


def _back(breach: Breach) -> Breach:
    """All run back the way they came."""
    return replace(breach, state=PhaseState(breach.state.q, -breach.state.p))


def _stopped(breach: Breach) -> Breach:
    """All lose their speed at once."""
    return replace(breach, state=PhaseState(breach.state.q, 0 * breach.state.p))


def _jumped(breach: Breach) -> Breach:
    """The first body is elsewhere, nearer to the middle, at the same speed."""
    q = breach.state.q.clone()
    outward = q[:, 0] / q[:, 0].norm(dim=-1, keepdim=True).clamp_min(1e-6)
    q[:, 0] = q[:, 0] - JUMP * outward
    return replace(breach, state=PhaseState(q, breach.state.p))


def _repelled(breach: Breach) -> Breach:
    """Bodies that attracted each other repel."""
    return replace(breach, params=breach.params.with_coupling(-breach.params.coupling))


def _same(breach: Breach) -> Breach:
    return breach


LAWFUL, VANISHED = "lawful", "vanished"
BREAKS: dict[str, Callable[[Breach], Breach]] = {
    VANISHED: _same,  # the first body is not drawn any more
    "turned": _turned,
    "back": _back,
    "stopped": _stopped,
    "jumped": _jumped,
    "repelled": _repelled,
}


@dataclass(frozen=True)
class Broken:
    """Lawful clips and what becomes of them.

    Args:
        clips: by name; ``lawful`` and :data:`BREAKS`, all of the same episodes.
        at: first frame that breaks the law, of each episode.
    """

    clips: dict[str, Clips]
    at: Tensor


def broken(scene: Scene, clips: Clips, stride: int, first: int, rng: Generator) -> Broken:
    """Break each of some lawful clips in every way, at a frame drawn for each episode.

    Args:
        scene: that the clips are of.
        clips: ``(b, t)`` frames.
        stride: reference steps between frames.
        first: frame before which none breaks.
        rng: of the frames.

    Returns:
        Only episodes whose bodies stay in the picture in all ways.
    """
    frames = clips.frames.shape[1]
    at = torch.randint(first, frames - 1, (len(clips),), generator=rng)
    before = clips.states[torch.arange(len(clips)), at - 1]
    found = {LAWFUL: clips.states.q}
    stays = torch.ones(len(clips), dtype=torch.bool)
    for name, change in BREAKS.items():
        after = change(Breach(before, clips.params))
        rolled = scene.simulate(after.state, after.params, stride * (frames - first), stride)
        stays &= certify(scene, rolled, clips.world.camera.half_extent).passed
        found[name] = _spliced(clips.states.q, rolled.states.q, at)
    late = torch.arange(frames) >= at[:, None]
    found[VANISHED][..., 0, :] = torch.where(late[..., None], FAR, found[VANISHED][..., 0, :])
    made = {name: _drawn(clips, q, stays) for name, q in found.items()}
    return Broken(made, at[stays])


def _spliced(lawful: Tensor, after: Tensor, at: Tensor) -> Tensor:
    """Lawful frames before ``at``, and then those that follow the state one frame before it."""
    time = torch.arange(lawful.shape[1])
    since = (time - at[:, None] + 1).clamp(0, after.shape[1] - 1)
    later = after[torch.arange(len(lawful))[:, None], since]
    return torch.where((time < at[:, None])[..., None, None], lawful, later)


def _drawn(clips: Clips, q: Tensor, kept: Tensor) -> Clips:
    q = q[kept]
    states = PhaseState(q, torch.full_like(q, torch.nan))  # none asks for momenta of the broken
    return replace(clips, frames=pictures(clips.world, q), states=states, params=clips.params[kept])
