"""Many clips at once: the same entries as one by one, in fewer passes, and what is left after."""

from __future__ import annotations

import sys
import threading
from dataclasses import replace

import numpy as np
import pytest
import torch

from encoders.store import FeatureStore
from tests.shared.small_clips import RATE, Cells, CellsSettings, cut_short, know_cells, write_clip
from vidphys.cli import main
from vidphys.data.ahead import ahead, prefetched
from vidphys.data.extraction import extract_layers
from vidphys.data.frames import held
from vidphys.data.listed import listed_clips
from vidphys.data.many import Wanted, cost_of, extract_many
from vidphys.data.resampling import at_rate, require_even
from vidphys.data.video import ClipSelection, open_video
from vidphys.errors import InputError

WHOLE = ClipSelection()


@pytest.fixture
def videos(tmp_path):
    for name, count in (("a", 5), ("b", 3), ("c", 9)):
        write_clip(tmp_path / "clips" / f"{name}.avi", count, table=False)
    return [open_video(tmp_path / "clips" / f"{name}.avi", WHOLE) for name in "abc"]


def wanted(folder, layers=("2", "8"), **settings):
    encoder = Cells(CellsSettings(**settings), "0" * 64)
    return Wanted(encoder, layers, FeatureStore(folder), "float32")


def test_clips_share_passes_and_their_entries_are_those_of_each_alone(videos, tmp_path):
    many, told = wanted(tmp_path / "many"), []
    before = Cells.passes
    busy = extract_many(iter(videos), many, lambda video, made: told.append((video, made)))
    assert Cells.passes - before == 3 and busy > 0  # 17 frames by 8, where one by one takes 4
    assert [(video.path.stem, tuple(made)) for video, made in told] == [
        ("a", ("2", "8")), ("b", ("2", "8")), ("c", ("2", "8"))
    ]  # fmt: skip
    alone = FeatureStore(tmp_path / "alone")
    for video in videos:
        singly = extract_layers(video, many.encoder, many.layers, alone, "float32")
        for layer, one in singly.items():
            found = many.store.read(many.requests(video)[layer])
            assert torch.equal(found.values, one.features.values)
            assert torch.equal(found.times, one.features.times)
            assert found.stride == one.features.stride
    told.clear()
    extract_many(iter(videos), many, lambda video, made: told.append(tuple(made)))
    assert told == [()] * 3 and Cells.passes - before == 7
    for manifest in (*many.store.entries(), *alone.entries()):
        assert manifest["made"]["decoder"].startswith("opencv-python-headless ")
        assert manifest["made"]["starts"] == 0


def test_frames_of_other_sizes_and_other_missing_layers_share_no_pass(videos, tmp_path):
    small = open_video(videos[0].path, ClipSelection(side=8))
    many = wanted(tmp_path / "s")
    extract_layers(videos[1], many.encoder, ["8"], many.store, "float32")
    made = {}
    extract_many(
        [small, *videos], many, lambda video, layers: made.setdefault(video.size, []).append(layers)
    )
    assert made[small.size] == [["2", "8"]]
    assert sorted(map(tuple, made[videos[0].size])) == [("2",), ("2", "8"), ("2", "8")]
    assert len([*many.store.entries()]) == 8 and many.store.verify() == []


def test_after_an_error_the_clips_before_it_are_whole_and_nothing_else_is_there(videos, tmp_path):
    many, done = wanted(tmp_path / "s"), []
    broken = cut_short(videos[2])
    with pytest.raises(InputError, match="cut short"):
        extract_many([*videos[:2], broken], many, lambda video, _: done.append(video.path.stem))
    assert done == ["a", "b"] and len([*many.store.entries()]) == 4
    assert not list(many.store.folder.rglob("*.partial")) and many.store.verify() == []


def test_what_takes_its_time_is_made_before_it_is_asked_for_and_errors_come_at_their_turn(
    monkeypatch,
):
    started = threading.Event()
    module = sys.modules["vidphys.data.ahead"]
    monkeypatch.setattr(module, "QUICK", 600.0)  # in place of the clock

    def second():
        started.set()
        return 2

    found = ahead([lambda: 1, second, lambda: 3])
    assert next(found) == 1 and not started.is_set()  # a hand-over would cost more
    assert [*found] == [2, 3] and started.is_set()
    started.clear()
    monkeypatch.setattr(module, "QUICK", 0.0)
    found = ahead([lambda: 1, second, lambda: 1 / 0, lambda: 4], most=2)
    assert next(found) == 1 and started.wait(60)
    assert next(found) == 2
    with pytest.raises(ZeroDivisionError):
        next(found)

    started.clear()
    monkeypatch.setattr(module, "WORKED", np.inf)  # all of them only waited for their turn
    found = ahead([lambda: 1, lambda: 2, lambda: 3, second, lambda: 5], most=2)
    assert [next(found) for _ in range(3)] == [1, 2, 3] and not started.is_set()
    assert [*found] == [2, 5]

    def items():
        yield from range(3)
        raise ValueError("no more")

    coming = prefetched(items())
    assert [next(coming) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match="no more"):
        next(coming)
    endless = prefetched(iter(int, 1))
    assert next(endless) == 0
    endless.close()


def test_a_pass_tells_what_all_will_cost(tmp_path):
    cost = cost_of(wanted(tmp_path, ("2", "8")), (16, 16))
    cells = (16 // 2) ** 2 + (16 // 8) ** 2
    assert cost.bytes == 4 * 3 * cells and cost.seconds > 0


def uneven(video):
    rng = np.random.default_rng(0)
    times = np.sort(np.arange(9) / 30 + rng.uniform(0, 0.02, 9))
    return replace(video, times=times)


def test_uneven_frames_are_taken_by_their_times_or_not_at_all(videos):
    clip = uneven(videos[2])
    require_even(clip, 1)
    require_even(videos[2], 3)
    with pytest.raises(InputError, match=r"early or late.*give `resample`"):
        require_even(clip, 2)
    found = at_rate(clip, 12)
    wanted_times = clip.times[0] + np.arange(len(found.times)) / 12
    assert np.abs(found.times - wanted_times).max() <= 0.5 * np.diff(clip.times).max()
    assert np.array_equal(np.asarray(found.frames), np.asarray(clip.frames)[found.indices])
    assert set(found.times) <= set(clip.times) and (np.diff(found.times) > 0).all()
    with pytest.raises(InputError, match="`resample` asks for 60; frames"):
        at_rate(clip, 60)
    even = at_rate(replace(videos[2], frames=held(np.asarray(videos[2].frames))), RATE / 2)
    assert even.indices.tolist() == [0, 2, 4, 6, 8]


def test_folders_patterns_and_lists_name_clips(videos, tmp_path):
    folder = tmp_path / "clips"
    names = [folder / f"{name}.avi" for name in "abc"]
    assert listed_clips([folder]) == listed_clips([folder / "*.avi"]) == names
    (tmp_path / "list.txt").write_text("# mine\nclips/c.avi\n\nclips/a.avi\n")
    assert listed_clips([tmp_path / "list.txt", names[2]]) == [names[2], names[0]]
    (tmp_path / "bad.txt").write_text("clips/z.avi\n")
    for place, said in [
        ("bad.txt", "line 1: no clip"),
        ("*.mp4", "no file has such a name"),
        ("a.avi", "no such file"),
    ]:
        with pytest.raises(InputError, match=said):
            listed_clips([tmp_path / place])


def test_the_verb_takes_a_folder_and_all_layers_and_goes_on(videos, tmp_path, capsys, monkeypatch):
    know_cells(monkeypatch)
    command = ["extract", str(tmp_path / "clips"), "--encoder", "cells", "--out"]
    out = [str(tmp_path / "s"), "--layers", "all", "--quiet"]
    assert main([*command, *out]) == 0
    said = capsys.readouterr().out
    assert "3 clips, about" in said and "3 layers take about" in said
    assert "b.avi: extracted, layer 4, 3 frames of 3 channels" in said
    assert "encoder busy" in said and "hit rate 0%" in said
    before = Cells.passes
    assert main([*command, *out]) == 0
    assert "hit rate 100%" in capsys.readouterr().out
    assert Cells.passes == before + 1  # to tell the cost
    assert main([*command, str(tmp_path / "s"), "--layer", "3", "--quiet"]) == 2
    assert "no layer 3; it has 2, 4, 8" in capsys.readouterr().err
    assert next(FeatureStore(tmp_path / "s").entries())["made"]["starts"] == 0


def test_the_verb_keeps_eight_bits_and_fewer_cells_and_no_whole_map_is_taken_from_them(
    videos, tmp_path, capsys, monkeypatch
):
    know_cells(monkeypatch)
    command = ["extract", str(tmp_path / "clips"), "--encoder", "cells", "--quiet", "--out"]
    small = [*command, str(tmp_path / "s"), "--store-dtype", "int8", "--grid", "3"]
    assert main(small) == 0
    assert "3 channels on a 3 x 3 grid" in capsys.readouterr().out
    assert main([*command, str(tmp_path / "s")]) == 0
    assert "hit rate 0%" in capsys.readouterr().out
    assert main(small) == 0
    assert "hit rate 100%" in capsys.readouterr().out
    kept = [*FeatureStore(tmp_path / "s").entries()]
    assert sorted(entry["shape"][2:] for entry in kept) == [[3, 3]] * 3 + [[8, 8]] * 3
    for entry in kept:
        asked = entry["request"]
        assert asked.get("grid") == (3 if entry["shape"][-1] == 3 else None)
        assert ("stored_error" in entry) == (asked["dtype"] == "int8") == ("grid" in asked)
    assert main([*small, "--shared"]) == 0
    assert "0 entries are new" in capsys.readouterr().out
    assert main([*small[:-2], "--grid", "0"]) == 2
    assert "need at least 1 cell" in capsys.readouterr().err


def test_a_pass_foretells_the_bytes_of_eight_bits_and_fewer_cells(tmp_path):
    eight = replace(wanted(tmp_path, ("2", "8")), dtype="int8", grid=4)
    assert cost_of(eight, (16, 16)).bytes == 3 * (4 * 4 + 8) + 3 * (2 * 2 + 8)
