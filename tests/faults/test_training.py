"""F3, F5: a loss or a gradient that is not finite, and checkpoints that are damaged."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import nn

from vidphys.errors import InputError
from vidphys.runs import checkpoint
from vidphys.runs.aside import sweep
from vidphys.runs.checkpoint import DamagedCheckpointWarning
from vidphys.training.ensemble import Ensemble
from vidphys.training.loop import FitSettings, SkippedBatchWarning, fit

DATA = torch.linspace(-1, 1, 32)[:, None]
SETTINGS = FitSettings(steps=12, batch=8, learning_rate=1e-2, save_every=2)
STATE = {"w": torch.arange(16.0)}


class BadGradient(torch.autograd.Function):
    """The identity, until its gradient is not finite."""

    @staticmethod
    def forward(ctx, x, bad):
        ctx.bad = bad
        return x.clone()

    @staticmethod
    def backward(ctx, gradient):
        return gradient * ctx.bad, None


def line() -> nn.Linear:
    torch.manual_seed(0)
    return nn.Linear(1, 1)


def turning_bad(model: nn.Module, at: int, bad: float):
    calls = []

    def loss(batch):
        calls.append(1)
        value = (model(batch) - 2 * batch).square().mean()
        return BadGradient.apply(value, bad if len(calls) == at else 1.0)

    return loss


@pytest.mark.parametrize("clip", [0.0, 1.0])
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_f5_a_finite_loss_with_a_bad_gradient_reaches_neither_weights_nor_checkpoint(
    tmp_path, clip, bad
):
    model, path = line(), tmp_path / "c.json"
    settings = FitSettings(12, 8, 1e-2, clip, save_every=2)
    said = r"the gradient is not finite at step 4, in the batch of examples \d+, "
    with pytest.raises(FloatingPointError, match=said):
        fit(model, turning_bad(model, 5, bad), DATA, settings, seed=0, save_to=path)
    assert all(bool(torch.isfinite(p).all()) for p in model.parameters())
    tensors, meta = checkpoint.load(path)
    assert meta["step"] == 4
    assert all(bool(torch.isfinite(t).all()) for t in tensors.values() if t.is_floating_point())


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_f5_a_batch_is_skipped_where_that_is_asked_for_and_its_name_is_said(tmp_path, bad):
    skipping, path = replace(SETTINGS, on_nan="skip"), tmp_path / "c.json"
    model = line()
    said = r"the gradient is not finite at step 4, in the batch of examples \d+, .*, 1 so far"
    with pytest.warns(SkippedBatchWarning, match=said):
        fit(model, turning_bad(model, 5, bad), DATA, skipping, seed=0, save_to=path)
    assert checkpoint.load(path)[1]["learners"][0]["skipped"] == 1
    assert all(bool(torch.isfinite(p).all()) for p in model.parameters())
    other = line()
    fit(other, turning_bad(other, 0, bad), DATA, SETTINGS, seed=0)
    assert not torch.equal(model.weight, other.weight)


def test_f5_a_training_that_stopped_goes_on_where_skipping_is_asked_for(tmp_path):
    path, model = tmp_path / "c.json", line()
    with pytest.raises(FloatingPointError):
        fit(model, turning_bad(model, 7, math.nan), DATA, SETTINGS, seed=0, save_to=path)
    whole, again = line(), line()
    skipping = replace(SETTINGS, on_nan="skip")
    with pytest.warns(SkippedBatchWarning):
        fit(whole, turning_bad(whole, 7, math.nan), DATA, skipping, seed=0)
    with pytest.warns(SkippedBatchWarning):  # the checkpoint is of step 6, before the batch
        fit(again, turning_bad(again, 1, math.nan), DATA, skipping, seed=0, save_to=path)
    assert torch.equal(again.weight, whole.weight)


def test_f5_more_than_a_tenth_of_the_batches_is_not_skipped():
    model, calls = line(), []

    def loss(batch):
        calls.append(1)
        return (model(batch) * math.nan if len(calls) > 3 else model(batch)).square().mean()

    skipping = replace(SETTINGS, on_nan="skip")
    with (
        pytest.warns(SkippedBatchWarning),
        pytest.raises(FloatingPointError, match="the loss is nan at step 4"),
    ):
        fit(model, loss, DATA, skipping, seed=0)


def test_f5_a_gradient_whose_square_is_too_large_is_no_bad_one():
    model = line()
    fit(model, turning_bad(model, 5, 1e30), DATA, SETTINGS, seed=0)


def test_f5_of_models_side_by_side_one_may_be_lost_and_not_all():
    models = Ensemble([line() for _ in range(2)])
    weight = models.weights["weight"]
    for number in range(2):
        (weight * torch.tensor([1.0, 2.0])[:, None, None]).sum().backward()
        weight.grad[number] = math.nan
        assert models.finite_members().tolist() == [False, number == 0]


def written(folder: Path, keep_last: bool = True) -> Path:
    path = folder / "c.json"
    for step in (1, 2, 3):
        checkpoint.save(path, STATE, {"step": step, "note": "mine"}, keep_last)
    return path


@pytest.mark.parametrize("keep_last", [False, True])
def test_the_checkpoint_before_stays_and_none_before_that(tmp_path, keep_last):
    written(tmp_path, keep_last)
    kept = sorted(path.name for path in tmp_path.iterdir())
    newest, last = ["c-00000003.safetensors", "c.json"], ["c-00000002.safetensors", "c.json.last"]
    assert kept == sorted(newest + (last if keep_last else []))


def test_f3_each_damaged_byte_of_the_json_is_seen(tmp_path):
    path = written(tmp_path, keep_last=False)
    whole = path.read_bytes()
    for place in range(len(whole)):
        for flip in (0x01, 0x10):
            path.write_bytes(whole[:place] + bytes([whole[place] ^ flip]) + whole[place + 1 :])
            try:
                tensors, meta = checkpoint.load(path)
            except InputError as error:
                assert str(tmp_path) in str(error)
            else:  # only what JSON does not read: the space between its words
                assert json.loads(path.read_bytes()) == json.loads(whole)
                assert meta["step"] == 3
    for length in range(len(whole) - 2):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"c\.json"):
            checkpoint.load(path)


@pytest.mark.parametrize("name", ["c.json", "c-00000003.safetensors"])
@pytest.mark.parametrize("part", range(4))
def test_f3_a_training_goes_on_from_the_checkpoint_before_a_damaged_one(tmp_path, name, part):
    path = written(tmp_path)
    data = bytearray((tmp_path / name).read_bytes())
    data[part * (len(data) - 3) // 4 + 2] ^= 0x40
    (tmp_path / name).write_bytes(data)
    with pytest.warns(DamagedCheckpointWarning, match=rf"{name}: .*the one before, step 2"):
        assert checkpoint.load_good(path)[1]["step"] == 2
    with pytest.raises(InputError, match=name):
        checkpoint.load(path)


def test_f2_a_training_whose_newest_checkpoint_is_damaged_ends_as_an_undisturbed_one(tmp_path):
    whole, path = line(), tmp_path / "c.json"
    fit(whole, turning_bad(whole, 0, 1.0), DATA, SETTINGS, seed=3)
    broken = line()
    with pytest.raises(FloatingPointError):
        fit(broken, turning_bad(broken, 8, math.nan), DATA, SETTINGS, seed=3, save_to=path)
    (tmp_path / "c-00000006.safetensors").write_bytes(b"")
    again = line()
    with pytest.warns(DamagedCheckpointWarning, match="step 4"):
        fit(again, turning_bad(again, 0, 1.0), DATA, SETTINGS, seed=3, save_to=path)
    assert torch.equal(again.weight, whole.weight)
    assert torch.equal(again.bias, whole.bias)


def test_f4_a_kill_between_any_two_writes_of_a_save_leaves_a_checkpoint(tmp_path, monkeypatch):
    class Kill(BaseException):
        pass

    replace = Path.replace
    for last in range(3):
        path = written(tmp_path / str(last))
        left = [last]

        def counted(self, target, left=left):
            if left[0] == 0:
                raise Kill
            left[0] -= 1
            return replace(self, target)

        with monkeypatch.context() as m, pytest.raises(Kill):
            m.setattr(Path, "replace", counted)
            checkpoint.save(path, STATE, {"step": 4}, keep_last=True)
        assert checkpoint.load(path)[1]["step"] == 3
        assert checkpoint.load(path.with_name("c.json.last"))[1]["step"] in (2, 3)
        checkpoint.save(path, STATE, {"step": 4}, keep_last=True)
        assert checkpoint.load(path)[1]["step"] == 4
        assert checkpoint.load(path.with_name("c.json.last"))[1]["step"] == 3


KILLED_IN_A_WRITE = """
import resource, signal, sys
from pathlib import Path

import torch
from vidphys.runs import checkpoint

signal.signal(signal.SIGXFSZ, signal.SIG_DFL)  # a write beyond the limit ends the process in it
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
checkpoint.save(Path(sys.argv[1]), {"w": torch.ones(4096)}, {"step": 1})
"""


@pytest.mark.skipif(not hasattr(signal, "SIGXFSZ"), reason="no limit of a file's size")
def test_f4_what_a_kill_inside_a_write_leaves_has_a_name_that_is_swept(tmp_path):
    folder = tmp_path / "checkpoints"
    folder.mkdir()
    asked = [sys.executable, "-B", "-c", KILLED_IN_A_WRITE, folder / "c.json"]
    assert subprocess.run(asked, check=False).returncode == -signal.SIGXFSZ
    assert len(list(folder.iterdir())) == 1
    sweep(tmp_path, ["checkpoints"])
    assert list(folder.iterdir()) == []
