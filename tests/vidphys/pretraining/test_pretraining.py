"""The tiny encoders: what the package holds, and how it is made."""

from __future__ import annotations

import json
import shutil
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file

import encoders.weights as weights_module
from encoders.frozen import load_encoder
from encoders.jepa import ema_momentum, follow
from encoders.known_weights import KNOWN
from encoders.release import release_files
from encoders.weights import PACKAGED, fetch, find_weights
from renderers import Camera, RgbWorld
from vidphys.data.clips import render_clips
from vidphys.errors import InputError
from vidphys.perception.base import FitTask
from vidphys.perception.catalogue import RUNGS
from vidphys.presets import PixelSizes
from vidphys.pretraining import run
from vidphys.pretraining.clips import COUPLINGS, Layout, RandomClips, Signs
from vidphys.pretraining.dino import FIRST_MOMENTUM
from vidphys.pretraining.run import OBJECTIVES, RECORD, Pretrained, pretrain, watch
from vidphys.progress import Progress
from vidphys.runs.lock import locked
from vidphys.scenes import gravity
from vidphys.training.loop import FitSettings

TINY = tuple(OBJECTIVES)
TWIN = "-attraction"
PACKED = (*TINY, *(f"{name}{TWIN}" for name in TINY))
MOST_BYTES = 1_000_000
GOLDEN = {
    "videomae-tiny": (1.9026, -0.2927, 1.0272),
    "vjepa2-tiny": (0.1147, -1.0062, 1.0061),
    "dino-tiny": (0.3374, -0.2938, 1.0155),
    "videomae-tiny-attraction": (1.8807, -0.3720, 1.0282),
    "vjepa2-tiny-attraction": (0.2302, -1.0340, 1.0061),
    "dino-tiny-attraction": (0.2742, 0.2121, 1.0158),
}
LAYOUT = Layout(frames=4, side=64, patch=4, tubelet=2, visible=0.2, asked=0.25)
TOY = FitSettings(steps=4, batch=2, learning_rate=1e-3, clip=1.0, save_every=2)


@pytest.fixture
def bare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine without any weights of its own."""
    monkeypatch.setenv(weights_module.FOLDER_VARIABLE, str(tmp_path / "nothing"))


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Little is simulated and watched."""
    monkeypatch.setattr(run, "TRAJECTORIES", 2)
    monkeypatch.setattr(run, "WATCHED", 4)


def test_the_package_holds_all_that_it_can_make() -> None:
    assert {name for name, entry in KNOWN.items() if entry.packaged} == set(PACKED)
    assert set(TINY) <= set(RUNGS)


@pytest.mark.parametrize("name", PACKED)
def test_packaged_weights_are_small_known_and_recorded(name: str, bare: None) -> None:
    found = find_weights(name)
    assert found.path == PACKAGED / name
    assert sum(file.stat().st_size for file in release_files(found.path)) <= MOST_BYTES
    record = json.loads((found.path / RECORD).read_text())
    assert record["name"] == name.removesuffix(TWIN)
    signs: Signs = "attraction" if name.endswith(TWIN) else "both"
    assert record["couplings"] == {"signs": signs, "range": list(COUPLINGS[signs])}
    assert record["sha256"] == found.sha256 == KNOWN[name].sha256[0]
    before, after = record["before"], record["after"]
    assert after["deviation"] > 1.2 * before["deviation"]
    # what a DINO is asked changes with its teacher, so that its losses do not compare
    assert after["loss"] < before["loss"] or record["name"] == "dino-tiny"
    assert fetch(name) == found


def test_package_data_names_the_weights() -> None:
    import tomllib

    text = (Path(__file__).parents[3] / "pyproject.toml").read_text()
    data = tomllib.loads(text)["tool"]["setuptools"]["package-data"]
    assert data["encoders"] == ["data/*/*", "weights.toml"]


def test_a_damaged_package_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weights_module, "PACKAGED", tmp_path)
    with pytest.raises(ValueError, match="get it by installing vidphys again"):
        find_weights("dino-tiny")
    copy = tmp_path / "dino-tiny"
    copy.mkdir()
    for file in release_files(PACKAGED / "dino-tiny"):
        (copy / file.name).write_bytes(file.read_bytes())
    find_weights("dino-tiny")
    (copy / "config.json").write_text((copy / "config.json").read_text() + " ")
    with pytest.raises(ValueError, match="damaged or another release"):
        find_weights("dino-tiny")


def two_bodies() -> torch.Tensor:
    """Four frames of two disks that move apart, ``(1, 4, 3, 64, 64)``."""
    step = torch.arange(4.0)[:, None]
    one = torch.cat([0.5 + 0.1 * step, -0.3 + 0.0 * step], 1)
    return RgbWorld()(torch.stack([one, -one], 1))[None]


@pytest.mark.parametrize("name", TINY)
def test_a_twin_differs_from_its_encoder_in_the_couplings_alone(name: str) -> None:
    made, twin = (
        json.loads((PACKAGED / each / RECORD).read_text()) for each in (name, f"{name}{TWIN}")
    )
    differ = {key for key in made if made[key] != twin[key]}
    assert differ == {"couplings", "before", "after", "sha256"}


@pytest.mark.parametrize("name", PACKED)
def test_golden_features(name: str, bare: None) -> None:
    values = load_encoder(name, {})(two_bodies(), torch.arange(4, dtype=torch.float64)).values
    found = torch.stack([values[0, 1, 0, 8, 9], values[0, 1, 1, 7, 6], values[0, 0].std()])
    torch.testing.assert_close(found, torch.tensor(GOLDEN[name]), atol=2e-3, rtol=0)


@pytest.mark.parametrize("name", TINY)
def test_features_of_a_clip_are_its_own(name: str, bare: None) -> None:
    encoder = load_encoder(name, {"batch": 2})
    clips = torch.rand(3, 5, 3, 32, 32)
    times = torch.arange(5, dtype=torch.float64)
    together = encoder(clips, times)
    assert together.values.shape == (3, 5 if name == "dino-tiny" else 3, 96, 16, 16)
    for clip, values in zip(clips, together.values, strict=True):
        torch.testing.assert_close(encoder(clip[None], times).values[0], values, atol=1e-5, rtol=0)


@pytest.mark.parametrize("name", TINY)
def test_features_differ_where_bodies_are(name: str, bare: None) -> None:
    """A collapsed encoder, or one that sees only where a token lies, has no spread here."""
    module = OBJECTIVES[name]()
    unseen = RandomClips(4, module.layout, 0)
    frames = unseen[torch.arange(16)].frames
    encoder = load_encoder(name, {})
    values = encoder(frames, torch.arange(frames.shape[1], dtype=torch.float64)).values
    centred = values.movedim(2, -1) - values.movedim(2, -1).mean(0)
    spectrum = torch.linalg.svdvals(centred.flatten(0, -2)).square()
    assert float(values.std(0).mean()) > 0.05
    # directions that are used; those of the backgrounds' colours are used most
    assert float(spectrum.sum().square() / spectrum.square().sum()) > 2


@pytest.mark.parametrize("name", TINY)
def test_the_rung_runs_on_a_bare_machine(name: str, bare: None) -> None:
    sizes = PixelSizes(6, 8, 40, 32, 2, 4, 0, 2)
    world = RgbWorld(Camera(height=32, width=32))
    clips = render_clips(gravity(mass=(1.0, 1.0)), world, 6, 8, 40, 0, "train")
    tracks = RUNGS[name].fit(FitTask(clips, sizes, 0, "factored")).tracks(clips)
    assert tracks.positions.shape == clips.states.q.shape
    assert bool(torch.isfinite(tracks.positions).all())


def test_an_example_is_a_function_of_its_number() -> None:
    clips, again = RandomClips(2, LAYOUT, 3), RandomClips(2, LAYOUT, 3)
    batch, other = clips[torch.tensor([5, 1234])], again[torch.tensor([1234])]
    assert torch.equal(batch.frames[1], other.frames[0])
    assert torch.equal(batch.visible[1], other.visible[0])
    assert not torch.equal(batch.frames[0], batch.frames[1])
    assert batch.frames.shape == (2, 4, 3, 64, 64)
    assert 0 <= float(batch.frames.min()) < float(batch.frames.max()) <= 1
    changed = RandomClips(2, LAYOUT, 4)[torch.tensor([1234])]
    assert not torch.equal(changed.frames, other.frames)


def test_other_colours_keep_greys_and_places() -> None:
    batch = RandomClips(2, LAYOUT, 3)[torch.arange(64)]
    seen = batch.recoloured().frames
    assert 0 <= float(seen.min()) < float(seen.max()) <= 1
    grey = replace(batch, frames=batch.frames.mean(2, keepdim=True).expand_as(batch.frames))
    changed = grey.recoloured().frames
    torch.testing.assert_close(changed, changed[:, :, :1].expand_as(changed), atol=1e-5, rtol=0)
    rising = batch.colours[..., :3].sum((1, 2)) > 0  # a negative makes what is brighter darker
    assert 0.6 < float(rising.float().mean()) < 0.95
    still = replace(batch, colours=torch.eye(3, 4).expand(64, 3, 4))
    torch.testing.assert_close(still.recoloured().frames, batch.frames, atol=1e-6, rtol=0)
    assert torch.equal(batch.recoloured().visible, batch.visible)


@pytest.mark.parametrize("name", TINY)
def test_only_the_student_of_pictures_sees_other_colours(name: str) -> None:
    torch.manual_seed(0)
    module: Any = OBJECTIVES[name]().eval()
    batch = RandomClips(2, module.layout, 3)[torch.arange(4)]
    other = replace(batch, colours=batch.colours.roll(1, 0))
    with torch.no_grad():
        assert torch.equal(module.features(batch), module.features(other))
        assert (float(module(batch)) != float(module(other))) == (name == "dino-tiny")


@pytest.mark.parametrize(("signs", "repelled"), [("both", True), ("attraction", False)])
def test_the_signs_of_the_couplings_reach_the_clips(signs: Signs, repelled: bool) -> None:
    """Whether any of two bodies is ever pushed away from the other."""
    pair = RandomClips(16, LAYOUT, 3, signs=signs).paths[0]
    apart = pair[:, :, 0] - pair[:, :, 1]
    along = (apart.diff(n=2, dim=1) * apart[:, 1:-1]).sum(-1)
    assert bool((along > 0).any()) == repelled


def test_what_is_asked_is_not_visible() -> None:
    batch = RandomClips(2, LAYOUT, 0)[torch.arange(3)]
    assert batch.visible.shape == (3, 102)
    assert batch.asked.shape == (3, 128)
    for seen, asked in zip(batch.visible, batch.asked, strict=True):
        assert len({*seen.tolist(), *asked.tolist()}) == 230
        assert seen.tolist() == sorted(seen.tolist())


def test_bodies_move_and_stay_mostly_in_sight() -> None:
    batch = RandomClips(4, LAYOUT, 0)[torch.arange(32)]
    moved = (batch.frames[:, -1] - batch.frames[:, 0]).abs().amax((1, 2, 3))
    light = batch.frames.flatten(1).std(1)
    assert float((moved > 0.1).float().mean()) > 0.8
    assert float((light > 0.02).float().mean()) > 0.9


def test_a_teacher_follows() -> None:
    teacher, student = torch.nn.Linear(2, 1), torch.nn.Linear(2, 1)
    wanted = 0.9 * teacher.weight + 0.1 * student.weight
    follow(teacher, student, 0.9)
    torch.testing.assert_close(teacher.weight, wanted)
    assert ema_momentum(0.0, FIRST_MOMENTUM) == pytest.approx(0.99)
    assert ema_momentum(1.0, FIRST_MOMENTUM) == 1.0


def stopped_at(last: int) -> Progress:
    """Asks the process to end after a step."""

    def progress(step: int, _steps: int, _loss: float) -> None:
        if step == last:
            signal.raise_signal(signal.SIGTERM)

    return progress


@pytest.mark.parametrize(
    "name", ["dino-tiny", *(pytest.param(x, marks=pytest.mark.slow) for x in TINY[:2])]
)
def test_an_interrupted_pretraining_ends_with_the_same_release(
    name: str, tmp_path: Path, few: None
) -> None:
    def trained(out: Path, progress: Progress | None = None) -> Pretrained:
        return pretrain(name, TOY, out, seed=1, progress=progress, signs="attraction")

    whole = trained(tmp_path / "whole")

    with pytest.raises(KeyboardInterrupt):
        trained(tmp_path / "cut", stopped_at(3))
    assert trained(tmp_path / "cut") == whole
    record = json.loads((tmp_path / "cut" / RECORD).read_text())
    assert record["couplings"] == {"signs": "attraction", "range": [0.0, 1.5]}
    files = {file.name for file in (tmp_path / "cut").iterdir()}
    assert files == {"config.json", "model.safetensors", RECORD}
    released = load_encoder(name, {}, _locked(tmp_path / "cut"))
    assert released.identity.weights_sha256 == whole.sha256
    assert all(
        t.dtype == torch.float16 for t in load_file(tmp_path / "cut" / "model.safetensors").values()
    )


ASKED: dict[str, Any] = {"name": "videomae-tiny", "settings": TOY, "seed": 1}


def held(folder: Path) -> dict[str, tuple[bytes, int]]:
    return {file.name: (file.read_bytes(), file.stat().st_mtime_ns) for file in folder.iterdir()}


def test_a_checkpoint_of_another_pretraining_is_refused(tmp_path: Path, few: None) -> None:
    with pytest.raises(KeyboardInterrupt):
        pretrain(**ASKED, out=tmp_path, progress=stopped_at(2))
    before = held(tmp_path)
    others: list[tuple[dict[str, Any], str]] = [
        ({"name": "dino-tiny"}, "made of name videomae-tiny, .*, not name dino-tiny"),
        ({"seed": 2}, "seed 1, not .* seed 2"),
        ({"signs": "attraction"}, "couplings both, .*, not .* couplings attraction"),
        ({"settings": replace(TOY, steps=6)}, "made with other settings .*'steps': 4"),
    ]
    for changed, told in others:
        match = f"^checkpoint .*{told}.*; use another folder, or delete"
        with pytest.raises(InputError, match=match):
            pretrain(**{**ASKED, **changed}, out=tmp_path)
        assert held(tmp_path) == before


def test_a_pretraining_that_has_ended_is_neither_done_again_nor_overwritten(
    tmp_path: Path, few: None
) -> None:
    made = pretrain(**ASKED, out=tmp_path / "made")
    before, steps = held(tmp_path / "made"), []
    again = pretrain(**ASKED, out=tmp_path / "made", progress=lambda step, *_: steps.append(step))
    assert again == made and steps == [] and held(tmp_path / "made") == before
    others: list[tuple[dict[str, Any], str]] = [
        ({"name": "dino-tiny"}, "name videomae-tiny, not name dino-tiny"),
        ({"seed": 2}, "made with seed 1, not seed 2;"),
        ({"signs": "attraction"}, "made with couplings both, not couplings attraction;"),
        ({"settings": replace(TOY, steps=6)}, "made with steps 4, not steps 6;"),
    ]
    for changed, told in others:
        with pytest.raises(InputError, match=f"holds a release .*{told}.*use another folder"):
            pretrain(**{**ASKED, **changed}, out=tmp_path / "made")
        assert held(tmp_path / "made") == before
    for lost in (RECORD, "config.json", "model.safetensors", "damaged"):
        unknown = Path(shutil.copytree(tmp_path / "made", tmp_path / lost))
        if lost == "damaged":
            (unknown / "config.json").write_text("{}")
        else:
            (unknown / lost).unlink()
        left = held(unknown)
        with pytest.raises(
            InputError, match="other files than a pretraining leaves .*use another folder"
        ):
            pretrain(**ASKED, out=unknown)
        assert held(unknown) == left


@pytest.mark.slow
def test_a_pretraining_killed_while_it_ends_ends(
    tmp_path: Path, few: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    whole = pretrain(**ASKED, out=tmp_path / "whole")
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(run, "write_json", killed)
        pretrain(**ASKED, out=tmp_path / "cut")
    assert (tmp_path / "cut" / "config.json").exists()
    assert pretrain(**ASKED, out=tmp_path / "cut") == whole


def _locked(release: Path) -> Path:
    weights_module.lock(release, None)
    return release


@pytest.mark.parametrize("name", TINY)
def test_a_few_steps_lower_the_loss(name: str, few: None) -> None:
    torch.manual_seed(0)
    module = OBJECTIVES[name]()
    clips = RandomClips(2, module.layout, 0)
    batch = clips[torch.arange(4)]
    optimiser = torch.optim.Adam([p for p in module.parameters() if p.requires_grad], 1e-3)
    losses = []
    for _ in range(8):
        loss = module(batch)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.97 * losses[0]


def test_watching_changes_nothing(few: None) -> None:
    module = OBJECTIVES["dino-tiny"]()
    before = {k: v.clone() for k, v in module.state_dict().items()}
    watch(module, RandomClips(1, module.layout, 0))
    assert all(torch.equal(v, before[k]) for k, v in module.state_dict().items())
    assert module.training


def test_what_cannot_be_trained_or_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="`steps` 0: must be at least 1"):
        pretrain(**{**ASKED, "settings": replace(TOY, steps=0)}, out=tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"file: cannot be written \(File exists\)"):
        pretrain(**ASKED, out=tmp_path / "file")


def test_one_pretraining_at_a_time_in_a_folder(tmp_path: Path) -> None:
    with locked(tmp_path), pytest.raises(InputError, match="another process is at work in it"):
        pretrain(**ASKED, out=tmp_path)


def test_an_unknown_name_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="pretraining dino: unknown; use one of videomae-tiny"):
        pretrain("dino", TOY, tmp_path, 0)
