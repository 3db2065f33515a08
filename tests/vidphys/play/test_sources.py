"""What can be played with: a diagnosed law from its tracks, the heads that a ladder kept."""

import json

import numpy as np
import pytest
import torch

from dynamics import HEADS, build, terms, to_config
from vidphys.diagnose.explanations.specification import as_specification
from vidphys.errors import InputError
from vidphys.play import Asked, answers, source_of
from vidphys.play.sources import FitSource
from vidphys.runs import checkpoint
from vidphys.runs.folder import RunFolder

RATE, INTERVAL = 0.5, 0.05


@pytest.fixture
def diagnosed(tmp_path):
    """A spring with friction as a diagnosis leaves it, and its track."""
    term = terms.Hamiltonian(
        potentials=(terms.Trap(4.0, learned=True),),
        ports=(terms.Drag("linear", "positive", RATE),),
    )
    held = as_specification(term, 1, [0.0, 0.0], {}, True, INTERVAL)
    (tmp_path / "specification.json").write_text(json.dumps(held))
    t = INTERVAL * np.arange(60)
    x = 2.0 * np.exp(-RATE / 2 * t) * np.cos(np.sqrt(4 - RATE**2 / 4) * t)
    rows = "\n".join(f"{a:.6f},{b:.8f},{b / 2:.8f}" for a, b in zip(t, x, strict=True))
    (tmp_path / "tracks.csv").write_text(f"t,x,y\n{rows}\n")
    return FitSource(tmp_path, tmp_path / "tracks.csv")


def rolled(stage, role, **more):
    asked = Asked(cell=stage.name, steps=400, **more)
    pieces = [piece for piece in answers(stage, asked) if piece and piece.about["role"] == role]
    left = [k for piece in pieces for k in piece.about.get("left", [])]
    return torch.cat([piece.places for piece in pieces], 1)[0, :, 0], pieces[0].about["dt"], left


def test_a_diagnosed_law_goes_on_from_its_tracks_in_their_units(diagnosed):
    stage = diagnosed.stage(diagnosed.names[0])
    told = stage.told()
    assert set(told["factors"]) == {"friction", "stiffness", "mass"} and told["coupling"] is None
    found, dt, left = rolled(stage, "model")
    t = INTERVAL * 59 + dt * np.arange(len(found))
    x = 2.0 * np.exp(-RATE / 2 * t) * np.cos(np.sqrt(4 - RATE**2 / 4) * t)
    assert np.abs(found[:, 0].numpy() - x).max() < 0.02
    assert set(left) == {-1}
    held, *_ = rolled(stage, "held")
    assert torch.equal(held, found)


@pytest.mark.slow
def test_without_friction_it_swings_on_and_the_law_that_held_stands_beside(diagnosed):
    stage = diagnosed.stage(diagnosed.names[0])
    free, *_ = rolled(stage, "model", factors={"friction": 0.0})
    held, *_ = rolled(stage, "held", factors={"friction": 0.0})
    before, *_ = rolled(stage, "model")
    assert torch.equal(held, before)
    last = len(free) // 2
    assert float(free[last:].abs().max()) > 1.1 * float(before[last:].abs().max())
    _, _, left = rolled(stage, "model", q=[[9.0, 0.0]])
    assert left[0] == 0


def test_a_diagnosis_that_kept_no_tracks_asks_for_its_table(diagnosed):
    source = FitSource(diagnosed.path, diagnosed.path / "other.csv")
    with pytest.raises(InputError, match="give the table as well"):
        source.stage(source.names[0])


def test_a_ladder_gives_its_heads_with_their_twins(tmp_path):
    settings = {
        "seeds": [0],
        "cells": ["ladder/oracle/unstructured", "oracle/factored", "ladder/renderer/factored"],
        "sizes": {"oracle": {"held_out": 4}},
        "scene": {"dt_seconds": 0.002},
    }
    run = RunFolder.open(tmp_path / "run", settings)
    for name in ("factored", "unstructured"):
        head = build(HEADS[name], bodies=3, dt=0.002)
        meta = {"step": 0, "terms": to_config(HEADS[name]), "bodies": 3, "dt": head.dt}
        folder = run.checkpoints(f"oracle-{name}-s0")
        checkpoint.save(folder / "head.json", dict(head.state_dict()), meta)
    source = source_of(str(tmp_path / "run"))
    assert source.names == ["oracle/factored", "oracle/unstructured"]  # the third kept no head
    stage = source.stage("oracle/unstructured")
    assert stage.episodes == 64 and stage.twin is None and stage.scene is not None
    assert any("Episodes from 4 on" in note for note in stage.notes)
    with pytest.raises(InputError, match="did you mean oracle/factored"):
        source.stage("oracle/factord")
