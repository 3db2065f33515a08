"""Clips of other kinds, and what a small training makes of them."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Generator

from tests.shared.small_clips import cells  # noqa: F401
from tests.shared.small_studies import TINY
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.pixels.unfamiliar import CHANGES, SAME, changed, flag_cell
from vidphys.shooting import step

SIZES = replace(TINY.pixel, clips=40, held_out=4)


def task(tmp_path: Path | None = None) -> CellTask:
    return CellTask("unfamiliar", "cells", (0,), TINY.oracle, SIZES, folder=tmp_path)


def made(kind: str):
    return changed(task(), 0, kind, Generator().manual_seed(0))


@pytest.mark.parametrize("kind", sorted(set(CHANGES) - {SAME}))
def test_a_change_changes_what_is_seen_and_nothing_that_is_told(kind):
    same, other = made(SAME), made(kind)
    assert other.frames.shape == same.frames.shape
    assert other.frames.dtype == torch.uint8
    assert other.interval == same.interval == pytest.approx(0.08)
    assert (other.params.coupling > 0).all()
    assert (other.frames[:, -1] != same.frames[:, -1]).any()
    moved = (other.states.q - same.states.q).abs().max() > 1e-9
    assert bool(moved) == (kind in ("repelled", "hurried"))


def test_every_kind_has_its_flags_and_shares_in_the_record(cells, tmp_path, monkeypatch):  # noqa: F811
    monkeypatch.setattr(step, "HEAD_DT", 0.05)
    for kind in set(CHANGES) - {SAME, "lit"}:
        monkeypatch.delitem(CHANGES, kind)
    asked = task(tmp_path)
    flag_cell("cells", asked)
    rows = {
        (r.origin.cell, row["metric"]): row["value"]
        for r in asked.recorders
        for row in r.tables()[0].to_pylist()
    }
    assert {cell for cell, _ in rows} == {f"cells/{kind}" for kind in CHANGES}
    assert rows["cells/same", "auroc_features"] == 0.5  # itself
    assert rows["cells/lit", "auroc_features"] > 0.9
    assert rows["cells/lit", "raised_any"] > rows["cells/same", "raised_any"]
