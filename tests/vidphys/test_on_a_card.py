"""What learns gives the same numbers on a card, and no tensor is at the wrong place: on no card."""

from dataclasses import replace

import pytest
import torch

from binders import Tracks
from dynamics import HEADS, Hamiltonian, engines
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import SoftenedGravity
from encoders import load_encoder
from encoders.store import FeatureStore
from readouts.differencing import central_difference
from tests.shared.card import BETWEEN, a_card
from tests.shared.recorded_steps import asking_and_plain, head_to_roll, recorded_and_plain
from tests.shared.small_clips import cut_short, write_clip
from tests.shared.small_studies import TINY
from tests.vidphys.cli.test_train_verb import coarse, write_folder
from tests.vidphys.training.test_probes import HALF, centres, features, states
from vidphys.cli import main
from vidphys.data.many import Wanted, extract_many
from vidphys.data.video import ClipSelection, open_video
from vidphys.errors import InputError
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.core.dissipation import score_retrace
from vidphys.experiments.core.oracle import held_out_question, true_segments
from vidphys.experiments.core.scoring import score_changed_law
from vidphys.experiments.core.trained import Training, train_cell
from vidphys.experiments.pixels.seen import draw, fit_perception, perceive, pixel_scene
from vidphys.perception.catalogue import RUNGS
from vidphys.placement import device_of, moved
from vidphys.presets import OracleSizes
from vidphys.reading.pipeline import load_pipeline
from vidphys.scenes import gravity
from vidphys.shooting.foretold import missed
from vidphys.shooting.initial_state import ShootingSettings, by_shooting, choose_slack
from vidphys.trade.scenery import Probe, encoded
from vidphys.training.learner import FitSettings
from vidphys.training.loop import fit
from vidphys.training.probes import Units, train_probes

SIZES = OracleSizes(2, 2, 8, (5e-3,), 2)
PIXEL = replace(TINY.pixel, clips=3, frames=8, image=32, perception_steps=1, held_out=1)


def both(numbers):
    """What is computed on the CPU, and on a card that is none."""
    here = numbers("cpu")
    with a_card():
        there = numbers("cuda")
    assert here.keys() == there.keys() and here
    for name, value in here.items():
        assert there[name] == pytest.approx(value, rel=1e-3, abs=1e-5), name


def examples(scene, _trajectories, seed):
    return true_segments(scene, 2, seed, oldest=0)


FEW = ("factored", "unstructured", "neural-ode")  # each way to a step; the others are slow


@pytest.mark.parametrize(
    "name", [x if x in FEW else pytest.param(x, marks=pytest.mark.slow) for x in HEADS.ours()]
)
def test_every_head_is_trained_and_rolled_there(name):
    scene = gravity("gaussian")

    def numbers(device):
        task = CellTask("mine", name, (0, 1), SIZES, device=device)
        how = Training(examples=examples)
        for seed, head, recorder in train_cell(task, name, HEADS[name], scene, how):
            assert device_of(head).type == device and recorder.origin.device.startswith(device)
            question = replace(held_out_question(scene, 2, seed), steps=10)
            law = question.params.with_coupling(-1.0)
            score_changed_law(recorder, head, question, law, question.params, -1.0)
            score_retrace(recorder, head, replace(question, steps=2))
        assert not BETWEEN  # so that a training step can be recorded
        rows = [row for each in task.recorders for row in each.tables()[0].to_pylist()]
        return {(r["seed"], r["metric"]): r["value"] for r in rows if r["value"] is not None}

    both(numbers)


@pytest.mark.parametrize(
    "rung",
    [
        "renderer",
        "cnn-supervised",
        "cnn-discovered",
        "jepa-centroid",
        "rgb-tracked",
        "anonymous-hand",
        pytest.param("anonymous-slots", marks=pytest.mark.slow),
        "dino-tiny",
        pytest.param("vjepa2-tiny", marks=pytest.mark.slow),
        pytest.param("composed", marks=pytest.mark.slow),
    ],
)
def test_rungs_learn_and_see_there(rung):
    grounding = RUNGS[rung]
    seen = draw(pixel_scene(), replace(grounding, share=1), PIXEL, 0)

    def numbers(device):
        fitted = fit_perception(grounding, seen, PIXEL, 0, "factored", None, None, device)
        found = perceive(fitted, seen, grounding.identified)
        assert found.test.positions.device.type == "cpu"
        return {"q": found.test.positions.flatten().tolist()}

    both(numbers)


def test_features_from_there_are_probed_here():
    clips = draw(pixel_scene(), replace(RUNGS["dino-tiny"], share=1), PIXEL, 0).train
    both(lambda device: {"nmse": Probe(clips).nmse(encoded(tiny(device), clips))})


def tiny(device):
    return load_encoder("dino-tiny", {}, None, device)


def test_a_probe_is_trained_there():
    truth = states(24)
    units, values = Units.of(truth, HALF), features(truth, True)
    frames = units.frames(values, centres(), truth)

    def numbers(device):
        parts = frames[slice(16)], frames[slice(16, 24)]
        how = FitSettings(steps=4, batch=8, learning_rate=0.01), "test", None, None, device
        (probe,) = train_probes(*parts, [0], *how)
        assert device_of(probe).type == device
        said = units.read(probe, values, centres())
        return {"q": said.q.flatten().tolist(), "p": said.p.flatten().tolist()}

    both(numbers)


def test_a_start_is_found_there_and_what_follows_foretold():
    scene = gravity("gaussian", mass=(1.0, 1.0))
    start, law = scene.sample(2, torch.Generator().manual_seed(0))
    path = scene.simulate(start, law, 240, 40)
    tracks = Tracks(path.states.q, torch.ones(path.states.q.shape[:-1]), path.times)
    settings = ShootingSettings(windows=(4, 3), slacks=(1.0, 0.1))
    torch.manual_seed(0)
    head = scene.build(HEADS["factored-radial"])

    def numbers(device):
        model = head.to(device, torch.float32)
        slack = choose_slack(model, tracks, law, 0.04, replace(settings, worse=1))
        found = by_shooting(model, tracks, law, 0.04, 0.1, settings)
        assert found.p.device.type == "cpu"
        # An untrained head explains no path. Its fits stop before their end, and slopes from
        # differences in float32 decide where; followed to the end, both places agree to 1e-4.
        off = missed(model.double(), tracks, law, 0.04, 3)
        return {"slack": slack, "p": found.p.flatten().tolist(), "missed": off.tolist()}

    both(numbers)


def test_a_training_goes_on_there_from_its_checkpoint(tmp_path):
    """As one that was not interrupted; the optimiser's own numbers lie on the card again too."""
    x = torch.linspace(-1, 1, 16)[:, None]

    def train(line, name, steps):
        settings = FitSettings(4, 4, 0.1, save_every=2)
        count = 0

        def progress(*_):
            nonlocal count
            count += 1
            if count == steps:
                raise KeyboardInterrupt

        def loss(batch):
            return (line(batch) - batch).square().mean()

        return fit(line, loss, x, settings, 0, tmp_path / name, progress)

    with a_card():
        lines = []
        for _ in range(3):
            torch.manual_seed(0)
            lines.append(torch.nn.Linear(1, 1).to("cuda"))
        train(lines[0], "whole.json", 9)
        with pytest.raises(KeyboardInterrupt):
            train(lines[1], "part.json", 3)
        train(lines[2], "part.json", 9)
        assert lines[2].weight.cpu().tolist() == lines[0].weight.cpu().tolist()


@pytest.mark.parametrize("name", ["dino-tiny", "vjepa2-tiny"])
def test_features_are_extracted_there(name, tmp_path):
    """Each pass is written while the next is computed, and clips before an error are whole."""
    videos = []
    for stem, count in (("a", 20), ("b", 9), ("c", 7)):
        write_clip(tmp_path / f"{stem}.avi", count, table=False)
        videos.append(open_video(tmp_path / f"{stem}.avi", ClipSelection()))

    clips = [*videos[:2], cut_short(videos[2])]

    def extracted(device):
        encoder = load_encoder(name, {"batch": 4}, None, device)
        store = FeatureStore(tmp_path / device)
        many = Wanted(encoder, encoder.layers, store, "float32")
        with pytest.raises(InputError, match="cut short"):
            extract_many(iter(clips), many, lambda video, layers: None)
        return {
            (video.path.stem, layer): store.read(request)
            for video in videos
            for layer, request in many.requests(video).items()
        }

    here = extracted("cpu")
    with a_card():
        there = extracted("cuda")
    for key, kept in here.items():
        assert (kept is None) == (there[key] is None) == (key[0] == "c")
        if kept is not None:
            assert torch.allclose(there[key].values, kept.values, atol=1e-5)


def test_a_clip_is_read_over_an_encoder_there(tmp_path, monkeypatch):
    """Trained on the card, and seen from there where it is seen on the CPU."""
    coarse(monkeypatch)
    data, run, clip = write_folder(tmp_path), tmp_path / "run", tmp_path / "new.avi"
    write_clip(clip, 20, phase=0.5, table=False)
    steps = ["--steps", "6", "--head-steps", "2", "--shift", "1", "--no-mirrors", "--quiet"]
    how = ["--encoder", "dino-tiny", *steps, "--store", str(tmp_path / "features")]
    how += ["--readout", "attention", "--widths", "8"]
    with a_card():
        assert main(["train", str(data), *how, "--out", str(run), "--device", "cuda"]) == 0

    def numbers(device):
        video = open_video(clip, ClipSelection())
        found = load_pipeline(run, device=device)(video.frames, video.times)
        return {"q": found.tracks.positions.flatten().tolist()}

    both(numbers)


def test_what_comes_from_a_card_is_wrong_until_it_is_waited_for():
    with a_card():
        x = torch.ones(2, device="cuda")
        here = torch.empty(2, pin_memory=True).copy_(x, non_blocking=True)
        event = torch.cuda.Event()
        event.record()
        assert here.tolist() != [1, 1]
        event.synchronize()
        assert here.tolist() == [1, 1]
        assert x[[1, 0]].tolist() == [1, 1]  # a list of places


@pytest.mark.parametrize("name", HEADS.ours())
@pytest.mark.parametrize("every", [1, 3])
def test_a_step_is_recorded_and_played_again(name, every, monkeypatch):
    monkeypatch.setattr(engines, "FEWEST_STEPS", 16)
    head, start, law, dt = head_to_roll(name)
    given = moved((start, law), "cpu", torch.float32)
    with torch.no_grad():
        here = head.plain_trajectory(*given, 18, dt, every).states
        with a_card():
            found = head.to("cuda").trajectory(*moved(given, "cuda"), 18, dt, every)
            assert found.backend == "cuda graph" and not BETWEEN
            there = moved(found.states, "cpu")
    moves = (here.flat - here.flat[:, :1]).abs().max()
    assert (there.flat - here.flat).abs().max() < 1e-5 * moves


def test_a_step_that_cannot_be_recorded_is_taken_as_it_is(monkeypatch):
    monkeypatch.setattr(engines, "FEWEST_STEPS", 16)

    class Asking(Hamiltonian):
        def advance(self, state, params, dt, memory=None):
            assert float(state.q.abs().max()) > 0
            return super().advance(state, params, dt, memory)

    start, law = gravity().sample(8, torch.Generator().manual_seed(0))
    given = moved((start, law), "cpu", torch.float32)
    head = Asking(FixedKinetic(), SoftenedGravity())
    with torch.no_grad():
        here = head.plain_trajectory(*given, 18, 0.01).states
        with a_card():
            found = head.trajectory(*moved(given, "cuda"), 18, 0.01)
            assert found.backend == "torch" and BETWEEN
            there = moved(found.states, "cpu")
    assert (there.flat - here.flat).abs().max() < 1e-5


def test_a_training_step_is_recorded_and_played_again():
    with a_card():
        recorded_and_plain()


def test_a_training_step_that_cannot_be_recorded_is_taken_as_it_is():
    with a_card():
        asking_and_plain()


def test_a_recording_changes_nothing_until_it_is_played():
    with a_card():
        x, graph = torch.ones(2, device="cuda"), torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            twice = x.mul_(2) + 1
        assert x.tolist() == [1, 1]
        graph.replay()
        graph.replay()
        assert x.tolist() == [4, 4] and twice.tolist() == [5, 5]
        with pytest.raises(RuntimeError, match="captur"), torch.cuda.graph(graph):
            x.tolist(), float(x.sum())


def test_what_a_card_refuses_is_refused():
    with a_card():
        x = torch.ones(2, device="cuda")
        with pytest.raises(RuntimeError, match="same device"):
            x + torch.ones(2)
        with pytest.raises(TypeError, match="numpy"):
            x.numpy()
        with pytest.raises(RuntimeError, match="generator"):
            torch.rand(2, generator=torch.Generator(), device="cuda")
        with pytest.raises(RuntimeError, match="same device"):
            central_difference(torch.ones(1, 4, 1, 2, device="cuda"), torch.ones(1, 1), 0.1)
