"""Training steps that are recorded on a card, real or not, beside the same that are not."""

import pytest
import torch

from dynamics import HEADS, Parameters, PhaseState
from vidphys.scenes import gravity
from vidphys.training.learner import FitSettings, Learner


def head_to_roll(name):
    """A new head, where eight episodes of its scene start, their law, and seconds of a step."""
    scene = gravity()
    start, law = scene.sample(8, torch.Generator().manual_seed(0))
    torch.manual_seed(0)
    head = scene.build(HEADS[name]).eval()
    head.set_scale(1e-3, 1e-3)
    return head, start, law, scene.dt


def steps_of_training(loss, records, steps=20):
    torch.manual_seed(0)
    head = gravity().build(HEADS["factored"]).to("cuda")
    learner = Learner(head, loss(head), FitSettings(steps, 64, 1e-2, clip=1.0))
    learner.records &= records
    rng = torch.Generator().manual_seed(0)
    batches = torch.randn(2, 64, 3, 2, generator=rng).to("cuda")
    found = []
    for step in range(steps):
        learner.update(batches[step % 2])
        found.append(learner.loss)
    return learner, found


def pull(head):
    """How far the forces are from a pull that falls off with the distance from the others."""

    law = Parameters(torch.ones(64, device="cuda"), torch.ones(64, 3, device="cuda"))

    def loss(q):
        others = q.mean(-2, keepdim=True) - q
        return (head.force(PhaseState(q, q), law) - others).square().mean()

    return loss


def recorded_and_plain():
    """Both come to the same losses."""
    (one, recorded), (other, plain) = (
        steps_of_training(pull, records) for records in (True, False)
    )
    assert one.recording is not None and one.recorded_change is not None
    assert other.recording is None and plain[-2] < 0.9 * plain[0]
    assert recorded == pytest.approx(plain, rel=1e-4)


def asking_and_plain():
    """A loss that asks the card for numbers is computed as it is."""

    def asking(head):
        return lambda q: pull(head)(q) * float(q.abs().max() > 0)

    learner, found = steps_of_training(asking, True)
    assert not learner.records and learner.recording is None
    assert found == pytest.approx(steps_of_training(pull, False)[1], rel=1e-4)
