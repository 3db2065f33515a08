import re
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

import vidphys
from encoders.features import FeatureMap
from vidphys.data.rendered import RenderSettings, render_folder
from vidphys.probing.probe import probe
from vidphys.runs.folder import RunFolder

CLIPS, FRAMES, SIDE = 60, 6, 16


def moving(seed=0):
    """Clips of a bright column that moves to the right by so many pixels a frame, or the left."""
    rng = np.random.default_rng(seed)
    drawn = rng.permutation(4 * SIDE)[:CLIPS]  # no clip twice
    speed, start = np.array([-2, -1, 1, 2])[drawn % 4], drawn // 4
    frames = torch.zeros(CLIPS, FRAMES, 3, SIDE, SIDE)
    for clip in range(CLIPS):
        for t in range(FRAMES):
            frames[clip, t, :, :, (start[clip] + speed[clip] * t) % SIDE] = 1
    return frames, speed


class Motion(nn.Module):
    """How much brighter a frame's right neighbours were a frame ago: it knows of motion alone."""

    def forward(self, frames):
        before = frames[:, [0, *range(FRAMES - 1)]]
        shifts = [(frames * before.roll(k, -1)).mean((2, 3, 4)) for k in (-2, -1, 1, 2)]
        return {"early": frames.mean((-2, -1)), "late": torch.stack(shifts, -1)}


@pytest.fixture(scope="module")
def found():
    frames, speed = moving()
    targets = {"speed": speed.astype(float), "class:way": np.sign(speed)}
    return probe(
        Motion(),
        frames,
        targets,
        untrained=lambda x: {"early": x[..., 0, 0], "late": 0 * x[..., 0, 0]},
    )


def test_motion_is_found_where_it_is(found):
    late = found.best("speed")
    assert (late.layer, late.depth) == ("late", 1.0) and late.score.value > 0.95
    early = next(f for f in found.findings if f.layer == "early" and f.target.name == "speed")
    assert early.score.value < 0.1 and early.selectivity.low <= 0
    assert late.selectivity.low > 0.5


def test_controls_take_away_what_they_say(found):
    for target in ("speed", "class:way"):
        controls = found.best(target).controls
        assert controls["one-frame"].value < 0.2
        assert controls["permuted"].value < 0.2 and abs(controls["constant"].value) < 0.1
        assert controls["pooled"].value > 0.9  # there is but one cell
        assert controls["random-weights"].value < 0.3
        assert controls["pixels"].value < found.best(target).score.value
    speed = found.best("speed")
    assert speed.controls["disorder"].value < speed.score.low - 0.1
    table = str(found)
    assert "class:way" in table and "random-weights" in table and "selectivity" in table


def test_a_probe_is_the_same_again():
    frames, speed = moving()
    once, again = (str(probe(Motion(), frames, {"v": speed * 1.0})) for _ in range(2))
    assert once == again


def test_any_form_of_features_is_taken():
    frames, _ = moving()
    level = {"level": frames.mean((-3, -2, -1)) + torch.arange(CLIPS)[:, None] / CLIPS}
    brighter = (frames * 0.1 + torch.arange(CLIPS).reshape(-1, 1, 1, 1, 1) / CLIPS).clamp(0, 1)

    def as_map(x):
        return FeatureMap(x[:, ::2], (1.0, 1.0), torch.arange(FRAMES / 2))

    for encoder in (lambda x: x.mean((1, 3, 4)), lambda x: x.mean((-2, -1)), as_map):
        best = probe(encoder, brighter, level).best("level")
        assert best.score.value > 0.98 and best.layer == "output"


def test_bytes_are_divided_for_an_encoder():
    frames = torch.randint(0, 255, (20, 3, 3, 4, 4), dtype=torch.uint8)
    largest = []

    def encoder(x):
        largest.append(float(x.max()))
        return x.mean((-2, -1))

    probe(encoder, frames, {"red": frames.float().mean((-2, -1))[..., 0]})
    assert max(largest) <= 1


def test_a_rendered_folder_has_the_targets_of_mechanics(tmp_path):
    settings = RenderSettings("gravity-and-coulomb", "rgb", 12, 6, 20, 16, 0)
    run = RunFolder.open(tmp_path / "clips", {"cells": [], "seeds": [0]})
    render_folder(run, settings)
    found = probe(lambda x: x, tmp_path / "clips")
    names = {f.target.name for f in found.findings}
    assert {"position", "velocity", "direction", "force", "mass", "charge", "coupling"} <= names
    assert found.skipped["count"] == "it is the same in all examples"
    kinds = {f.target.name: (f.target.kind, f.target.per) for f in found.findings}
    assert kinds["charge"] == ("classification", "clip")
    assert kinds["direction"] == ("circular", "body")
    assert found.best("position").score.value > 0.1
    with pytest.raises(vidphys.InputError, match="target count: it is the same"):
        probe(lambda x: x, tmp_path / "clips", ["count"])


def test_own_encoder_and_labels_with_all_controls_are_fifteen_lines():
    """The page's block itself is run by the tests of the project."""
    page = Path(__file__).parents[3] / "docs" / "probing.md"
    (block,) = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.S)
    assert "vidphys.probe(" in block
    assert len([line for line in block.splitlines() if line.strip()]) <= 15


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((3, torch.zeros(20, 2, 3, 4, 4), {"a": np.zeros(20)}), "must be callable on frames"),
        ((len, torch.zeros(20, 2, 4, 4, 3), {"a": np.zeros(20)}), r"frames \(clips, t, 3, H, W\)"),
        ((len, torch.zeros(20, 2, 3, 4, 4), {"a": np.zeros(7)}), r"must be \(20,\), \(20, 2\)"),
        ((len, torch.zeros(20, 2, 3, 4, 4), ["a"]), "values by name"),
        ((len, torch.rand(4, 2, 3, 4, 4), {"a": np.arange(4.0)}), "4 clips; `folds` 5"),
        ((len, torch.rand(20, 2, 3, 4, 4), {"a": np.zeros(20)}), "nothing can be learned"),
        ((len, torch.rand(20, 2, 3, 4, 4), {"a": np.arange(20.0)}), "must give features"),
        ((len, "clips", {"a": np.zeros(20)}), "of a folder are names"),
        ((len, torch.zeros(20, 2, 3, 4, 4), {"a": np.zeros(20)}), "clip 0 and clip 1 are the same"),
    ],
)
def test_what_is_wrong_is_said(arguments, message):
    with pytest.raises(ValueError, match=message):
        probe(*arguments)


def test_more_frames_than_a_clip_has_are_refused():
    with pytest.raises(ValueError, match="`each` 9: a clip has 6 frames"):
        probe(Motion(), *moving()[:1], {"v": moving()[1] * 1.0}, each=9)
