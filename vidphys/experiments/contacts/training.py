"""Training of hard disks from stretches of flight in which one collision was seen."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Generator, Tensor

from dynamics import Head
from dynamics.events import HardDisks, bounce
from dynamics.pairs import pair_indices
from vidphys.experiments.core.members import Examples
from vidphys.experiments.core.oracle import HORIZON, true_trajectories
from vidphys.scenes import Scene
from vidphys.seeding import derive
from vidphys.training.segments import Scale, Segments, from_trajectory

LEAST = 2  # collisions: one to learn from and one held out


def stretches(scene: Scene, trajectories: int, seed: int) -> Examples:
    """The training trajectories of :func:`true_segments` as one stretch each.

    Only those in which exactly one pair collided tell anything of a collision: they are drawn
    from with replacement, up to ``trajectories`` examples; one in eight is held out.

    Raises:
        ValueError: too few collisions were met.
    """
    path = true_trajectories(scene, trajectories, seed)
    ends = path.states.map(lambda x: x[:, [0, -1]])
    found = from_trajectory(replace(path, states=ends), k=1, every=HORIZON)
    # The stored interval is the whole trajectory, not one step of it.
    found = replace(found, dt=path.dt)
    assert found.p is not None
    one = colliding_pair(found.p[:, 0]).any(-1).nonzero().squeeze(-1)
    if len(one) < LEAST:
        raise ValueError(
            f"stretches: {len(one)} collisions in {trajectories} trajectories of {scene.name}; "
            "use more trajectories"
        )
    rng = Generator().manual_seed(derive(seed, "collisions"))
    held_out = max(1, len(one) // 8)
    train, kept = one[held_out:], one[:held_out]
    draw = torch.randint(len(train), (trajectories,), generator=rng)
    again = torch.randint(len(kept), (max(1, trajectories // 8),), generator=rng)
    return Examples(found[train[draw]], found[kept[again]])


def colliding_pair(change: Tensor) -> Tensor:
    """Which pair collided, ``(m, pairs)``, from momentum changes ``(m, n, d)``.

    No pair where the momenta of more or fewer than two bodies changed.
    """
    moved = change.abs().sum(-1) > 0
    i, j = pair_indices(change.shape[-2], change.device)
    alone = moved.sum(-1, keepdim=True) == 2
    return moved[..., i] & moved[..., j] & alone


def collision_loss(head: Head, batch: Segments, scale: Scale) -> Tensor:
    """Error of the places and momenta after the one collision that each stretch saw.

    The pair that collided is known from the data; when and how is the head's answer. Its time is
    not held to the stretch, so that the diameter has a gradient also where the guess is far off.

    Raises:
        TypeError: the head is not made of hard disks.
    """
    if not isinstance(head, HardDisks):
        raise TypeError(f"collision_loss: needs HardDisks, got {type(head).__name__}")
    assert batch.p is not None
    weight = colliding_pair(batch.p[:, 0]).to(batch.q.dtype)
    times, discriminant = head.collision_times(batch.start, batch.params)
    seen = weight * (discriminant > 0) * torch.isfinite(times)
    times = torch.where(seen > 0, times, torch.zeros_like(times)).unsqueeze(-1)
    i, j = pair_indices(batch.start.q.shape[-2], batch.q.device)
    mass = batch.params.mass.unsqueeze(-1)
    m_i, m_j = mass[..., i, :], mass[..., j, :]
    v = batch.start.p / mass
    relative = v[..., i, :] - v[..., j, :]
    apart = head.law.nearest(batch.start.q[..., i, :] - batch.start.q[..., j, :])
    push = bounce(apart + times * relative, relative, m_i, m_j)
    # What body i gains, and where it is at the end: it flies with the new speed since the bounce.
    flight = batch.dt * batch.every
    q = v[..., i, :] * flight + push / m_i * (flight - times)
    error_p = (push - batch.p[:, 0][..., i, :]) / scale.p
    error_q = (q - batch.q[:, 0][..., i, :]) / scale.q
    error = (error_p.square() + error_q.square()).sum(-1)
    return (seen * error).sum() / seen.sum().clamp_min(1)
