"""The training loop and its checkpoints: resumed means the same run, damaged means an error."""

import json
import math
import signal

import pytest
import torch
from torch import nn

from vidphys.errors import InputError
from vidphys.runs import checkpoint
from vidphys.training.loop import FitSettings, choose_learning_rate, fit, one_cycle

X = torch.linspace(-1, 1, 64).unsqueeze(1)
DATA = torch.cat([X, (3 * X).sin()], 1)


def network(seed: int = 0) -> nn.Module:
    torch.manual_seed(seed)
    return nn.Sequential(nn.Linear(1, 16), nn.Tanh(), nn.Linear(16, 1))


def loss_of(model: nn.Module):
    return lambda batch: (model(batch[:, :1]) - batch[:, 1:]).square().mean()


SETTINGS = FitSettings(steps=60, batch=16, learning_rate=1e-2, save_every=10)


def weights(model: nn.Module) -> torch.Tensor:
    return torch.cat([p.detach().flatten() for p in model.parameters()])


def test_training_learns():
    model = network()
    before = loss_of(model)(DATA).item()
    fit(model, loss_of(model), DATA, FitSettings(400, 32, 5e-2), seed=1)
    assert loss_of(model)(DATA).item() < 0.1 * before


@pytest.mark.parametrize("cut", [1, 10, 15, 37, 59])
def test_an_interrupted_run_ends_with_the_same_bits(tmp_path, cut):
    whole = network()
    fit(whole, loss_of(whole), DATA, SETTINGS, seed=3)

    path = tmp_path / "run.json"
    first = network()

    def stop(step, _steps, _loss):
        if step == cut:
            signal.raise_signal(signal.SIGTERM)

    with pytest.raises(KeyboardInterrupt):
        fit(first, loss_of(first), DATA, SETTINGS, seed=3, save_to=path, progress=stop)
    again = network(seed=99)
    fit(again, loss_of(again), DATA, SETTINGS, seed=3, save_to=path)
    assert torch.equal(weights(again), weights(whole))
    assert not torch.equal(weights(first), weights(whole))


def test_a_nonfinite_loss_stops_before_it_reaches_the_weights():
    model = network()
    calls = []

    def loss(batch):
        calls.append(weights(model))
        value = loss_of(model)(batch)
        return value * math.nan if len(calls) == 5 else value

    with pytest.raises(FloatingPointError, match="step 4"):
        fit(model, loss, DATA, SETTINGS, seed=0)
    assert torch.equal(weights(model), calls[-1])


def test_other_settings_do_not_resume(tmp_path):
    path = tmp_path / "run.json"
    model = network()
    fit(model, loss_of(model), DATA, SETTINGS, seed=0, save_to=path)
    other = FitSettings(steps=70, batch=16, learning_rate=1e-2, save_every=10)
    with pytest.raises(InputError, match="other settings"):
        fit(model, loss_of(model), DATA, other, seed=0, save_to=path)
    checkpoint.save(path, {"w": torch.zeros(1)}, {"step": 3})  # as written by another version
    with pytest.raises(InputError, match="0 models, not 1.; use another folder"):
        fit(model, loss_of(model), DATA, SETTINGS, seed=0, save_to=path)


def test_checkpoint_keeps_one_tensor_file_and_round_trips(tmp_path):
    path = tmp_path / "c.json"
    for step in (1, 2):
        checkpoint.save(path, {"w": torch.full((3,), float(step))}, {"step": step, "note": "x"})
    tensors, meta = checkpoint.load(path)
    assert torch.equal(tensors["w"], torch.full((3,), 2.0)) and meta == {"step": 2, "note": "x"}
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("part", range(8))
def test_a_damaged_checkpoint_is_named_never_loaded(tmp_path, part):
    path = tmp_path / "c.json"
    checkpoint.save(path, {"w": torch.arange(64.0)}, {"step": 1})
    target = next(tmp_path.glob("*.safetensors"))
    data = bytearray(target.read_bytes())
    data[part * len(data) // 8] ^= 0x40
    target.write_bytes(data)
    with pytest.raises(InputError, match="damaged"):
        checkpoint.load(path)


def test_a_killed_save_leaves_the_last_checkpoint_whole(tmp_path, monkeypatch):
    path = tmp_path / "c.json"
    checkpoint.save(path, {"w": torch.ones(2)}, {"step": 1})

    def die(*_):
        raise OSError("no space left")

    monkeypatch.setattr(checkpoint, "write_json", die)
    with pytest.raises(OSError, match="no space"):
        checkpoint.save(path, {"w": torch.zeros(2)}, {"step": 2})
    assert torch.equal(checkpoint.load(path)[0]["w"], torch.ones(2))


def test_schema_and_garbage_are_refused(tmp_path):
    path = tmp_path / "c.json"
    path.write_text("not json")
    with pytest.raises(InputError, match="not readable"):
        checkpoint.load(path)
    path.write_text(json.dumps({"schema_version": 99, "tensors": "x", "sha256": "", "meta": {}}))
    with pytest.raises(InputError, match="schema version 99"):
        checkpoint.load(path)


def test_learning_rate_is_chosen_on_held_out_error_and_leaves_the_model_alone():
    model = network()
    before = weights(model)
    probe = FitSettings(steps=50, batch=16, learning_rate=0.0)
    choice = choose_learning_rate(model, loss_of, DATA, DATA, (1e-6, 1e-2), probe, seed=0)
    assert choice.chosen == 1e-2 and choice.errors[1e-2] < choice.errors[1e-6]
    assert torch.equal(weights(model), before)
    assert choose_learning_rate(model, loss_of, DATA, DATA, (5.0,), probe, 0).chosen == 5.0


def test_schedule_warms_up_and_ends_at_zero():
    factors = [one_cycle(i / 1000) for i in range(1001)]
    assert max(factors) == pytest.approx(1.0) and factors[0] < 0.05
    assert factors[-1] == pytest.approx(0.0, abs=1e-12)
