"""Clips in which nature errs: from one frame on, a body or all of them break their law.

The pairs are as in tests of intuitive physics (Riochet et al., IntPhys, 2018): a broken clip and
its lawful twin are the same pictures up to the frame at which they part.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import cast

import torch
from torch import Generator, Tensor

from dynamics import Hamiltonian, Parameters, PhaseState
from dynamics.contact import SoftContact
from dynamics.potentials import Potential, SumPotential
from vidphys.data.clips import Clips, pictures
from vidphys.scenes import Scene, certify
from vidphys.scenes.scene import closest
from vidphys.scenes.strikes import DIAMETER

FAR = 1e3  # world units; where no camera looks
JUMP = 0.75  # world units
NEVER = -1  # no frame
PARTED = 3  # frames after the first of a strike, in which bodies go through and are seen to


@dataclass(frozen=True)
class Breach:
    """How one clip goes on from the state at which it breaks its law.

    Args:
        state: at the break, of all clips, ``(b, n, d)``; the others' order of bodies is random, so
            the first body is any.
        params: the law's numbers.
        scene: whose law it is.
    """

    state: PhaseState
    params: Parameters
    scene: Scene


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


def _passed(breach: Breach) -> Breach:
    """Bodies that strike each other go through one another."""
    law = breach.scene.law
    assert isinstance(law, Hamiltonian) and isinstance(law.potential, SumPotential)
    left = [part for part in law.potential.parts if not isinstance(part, SoftContact)]
    through = Hamiltonian(law.kinetic, SumPotential(cast(list[Potential], left)), law.integrator)
    return replace(breach, scene=replace(breach.scene, law=through))


def _same(breach: Breach) -> Breach:
    return breach


Change = Callable[[Breach], Breach]
LAWFUL, VANISHED, PASSED = "lawful", "vanished", "passed"
BREAKS: dict[str, Change] = {
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


def _any_frame(clips: Clips, first: int, rng: Generator) -> Tensor:
    """One of each clip from ``first`` on, but for the last, ``(b,)``."""
    return torch.randint(first, clips.frames.shape[1] - 1, (len(clips),), generator=rng)


def _first_strike(clips: Clips, first: int, rng: Generator) -> Tensor:
    """The first frame from ``first`` on at which bodies have come to touch, ``(b,)``.

    It is no frame where there is none, or where the clip ends before they have parted.
    """
    touch = closest(clips.states.q) < DIAMETER
    touch[:, 1:] &= ~touch[:, :-1].clone()
    touch[:, :first] = touch[:, -PARTED:] = False
    return torch.where(touch.any(1), touch.int().argmax(1), NEVER)


@dataclass(frozen=True)
class Breaks:
    """How clips are broken.

    Args:
        at: the first frame of each clip that breaks the law, ``(b,)``, not before a given one;
            :data:`NEVER` leaves a clip out.
        ways: by name.
    """

    at: Callable[[Clips, int, Generator], Tensor]
    ways: Mapping[str, Change]


ANYWHERE = Breaks(_any_frame, BREAKS)
AT_A_STRIKE = Breaks(_first_strike, {PASSED: _passed})


def broken(
    scene: Scene,
    clips: Clips,
    stride: int,
    first: int,
    rng: Generator,
    breaks: Breaks = ANYWHERE,
) -> Broken:
    """Break each of some lawful clips in every way.

    Args:
        scene: that the clips are of.
        clips: ``(b, t)`` frames.
        stride: reference steps between frames.
        first: frame before which none breaks.
        rng: of the frames.
        breaks: where and how.

    Returns:
        Only episodes whose bodies stay in the picture in all ways.
    """
    at, frames = breaks.at(clips, first, rng), clips.frames.shape[1]
    before = clips.states[torch.arange(len(clips)), at - 1]
    found = {LAWFUL: clips.states.q}
    stays = at != NEVER
    for name, change in breaks.ways.items():
        after, steps = change(Breach(before, clips.params, scene)), stride * (frames - first)
        rolled = after.scene.simulate(after.state, after.params, steps, stride)
        stays &= certify(after.scene, rolled, clips.world.camera.half_extent).passed
        found[name] = _spliced(clips.states.q, rolled.states.q, at)
    if VANISHED in found:
        gone = (torch.arange(frames) >= at[:, None])[..., None]
        found[VANISHED][..., 0, :] = torch.where(gone, FAR, found[VANISHED][..., 0, :])
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
