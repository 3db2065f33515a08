"""A run folder of before terms had names: its head, its weights and its scene are read."""

from pathlib import Path

import torch

from dynamics import HEADS, PhaseState, build, from_config, rollout, terms
from dynamics.state import Parameters
from vidphys.diagnose.explanations.specification import read_specification
from vidphys.runs import checkpoint

OLD = Path(__file__).parent / "old_run"


def test_an_old_head_is_built_and_its_weights_are_loaded():
    tensors, meta = checkpoint.load(OLD / "head.json")
    term = from_config(meta["terms"])
    assert term == HEADS["factored"]
    head = build(term, meta["bodies"], 0.01)
    head.load_state_dict(tensors)
    start = PhaseState(torch.eye(3)[None, :, :2], torch.zeros(1, 3, 2))
    run = rollout(head, start, Parameters(torch.ones(1), torch.ones(1, 3)), 3, 0.01)
    assert bool(run.states.q.isfinite().all())


def test_an_old_specification_is_read():
    term, held = read_specification(OLD / "specification.json")
    free = terms.Hamiltonian(
        potentials=(terms.NoPotential(), terms.Uniform()), ports=(terms.Drag(),)
    )
    assert term == terms.Walled(free, 0.0, 0.8, (0.0, -1.0))
    assert held["origin"] == [0.5, 0.25]
