"""The seeds of a cell side by side: one start, one truth, a model each."""

import numpy as np
import pytest
import torch

from dynamics import HEADS, build, to_config
from tests.viz.test_viz import read_back
from vidphys.cli.seeds import write_seeds
from vidphys.errors import InputError
from vidphys.runs import checkpoint
from vidphys.runs.folder import RunFolder


def test_each_seed_rolls_the_same_start_by_its_own_model(tmp_path):
    settings = {"seeds": [0, 1, 2], "cells": ["ladder/oracle/unstructured"]}
    run = RunFolder.open(tmp_path / "run", settings)
    for seed in (0, 2):  # the third kept none
        torch.manual_seed(seed)
        head = build(HEADS["unstructured"], bodies=3, dt=0.002)
        meta = {"step": 0, "terms": to_config(HEADS["unstructured"]), "bodies": 3, "dt": head.dt}
        folder = run.checkpoints(f"oracle-unstructured-s{seed}")
        checkpoint.save(folder / "head.json", dict(head.state_dict()), meta)
    write_seeds(tmp_path / "run", "oracle/unstructured", tmp_path / "seeds.rrd")
    found = read_back(tmp_path / "seeds.rrd")
    assert not any(entity.startswith("/seed/1") for entity in found)
    truth, first, other = (
        np.array(found[f"/seed/{name}"]["Points2D:positions"], np.float64)
        for name in ("0/counterfactual_truth", "0/counterfactual", "2/counterfactual")
    )
    again = np.array(found["/seed/2/counterfactual_truth"]["Points2D:positions"])
    assert np.array_equal(truth, again) and len(truth) == 101
    assert np.allclose(first[0], truth[0]) and np.allclose(other[0], truth[0], atol=1e-6)
    assert np.abs(first - other).max() > 1e-3
    off = np.array(found["/distance/counterfactual/2"]["Scalars:scalars"])[:, 0]
    assert np.allclose(off, np.linalg.norm(other - truth, axis=-1).mean(1), atol=1e-5)
    with pytest.raises(InputError, match="kept no model of oracle/factored"):
        write_seeds(tmp_path / "run", "oracle/factored", tmp_path / "none.rrd")
