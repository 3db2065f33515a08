"""Splits by clip, by a fact, by time and as a data set says: no clip is ever in two of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from vidphys.data.clip_files import ClipFile
from vidphys.data.splits import roles_by_group, roles_by_name, split_times
from vidphys.errors import InputError
from vidphys.reading.seen_clips import split_of

FRAMES = 100


@dataclass(frozen=True)
class Clip:
    """As much of a seen clip as a split looks at."""

    file: ClipFile
    about: dict[str, str]
    frames: int = FRAMES

    @property
    def labels(self) -> SimpleNamespace:
        return SimpleNamespace(times=torch.arange(self.frames))

    @property
    def features(self) -> dict[None, SimpleNamespace]:
        return {None: SimpleNamespace(values=torch.zeros(1, self.frames, 1, 1, 1))}


def clips(count: int, split: str = "", **facts: list) -> list[Clip]:
    return [
        Clip(
            ClipFile(
                Path(f"{k}.mp4"),
                facts={name: values[k] for name, values in facts.items()},
                split=split.split()[k] if split else "",
            ),
            {"sha256": f"{k:064d}"},
        )
        for k in range(count)
    ]


def roles(found: list[Clip], by: str = "auto") -> str:
    """t, h or s for each clip."""
    split = split_of(found, None, 1, 0.6, by)  # type: ignore[arg-type]
    parts = zip(split.train, split.held_out, split.scored, strict=True)
    return "".join("ths"[[len(x) > 0 for x in part].index(True)] for part in parts)


def test_whole_clips_unless_something_is_said() -> None:
    assert roles(clips(10)) == "tthtttssss"
    assert roles(clips(10), "clip") == "tthtttssss"


def test_clips_with_the_same_fact_stay_together() -> None:
    who = ["a", "b", "a", "c", "d", "b", "e", "e", "c", "d"]
    found = roles(clips(10, who=who), "who")
    by_who = {w: {r for x, r in zip(who, found, strict=True) if x == w} for w in who}
    assert all(len(each) == 1 for each in by_who.values()) and set(found) == set("ths")
    with pytest.raises(InputError, match="no fact 'when' to split by; it has who; or use auto"):
        roles(clips(10, who=who), "when")
    with pytest.raises(InputError, match="leaves 1 of 2 groups of clips to train on"):
        roles(clips(4, who=["a", "a", "b", "b"]), "who")


def test_two_cameras_of_an_episode_stay_together() -> None:
    cameras = ["left", "right"] * 5
    found = roles(clips(10, camera=cameras, episode_index=[k // 2 for k in range(10)]))
    assert found[::2] == found[1::2] and set(found) == set("ths")


def test_a_data_set_says_which_is_which() -> None:
    assert roles(clips(4, "train val test train")) == "thst"
    assert roles(clips(4, "train train train test")) == "tths"
    assert roles(clips(4, "train train validation train")) == "ttsh"
    assert roles(clips(5, "train train train train train")) == "tthss"
    assert roles(clips(4, "train val test train"), "clip") == "thss"
    with pytest.raises(InputError, match="split 'extra': a data set has train, val and test"):
        roles(clips(4, "train extra test train"))
    with pytest.raises(InputError, match="^a clip in no split: .*; `split_by` clip, time or a"):
        roles_by_name(["train", "", "test", "train"], range(4))
    with pytest.raises(InputError, match="leave no clip to train on"):
        roles(clips(3, "test test val"))
    with pytest.raises(InputError, match="split train: needs at least two clips"):
        roles(clips(2, "train test"))
    assert roles_by_name(["", ""], [0, 1]) is None


@pytest.mark.parametrize("by", ["auto", "clip"])
def test_a_clip_in_two_splits_is_an_error_whatever_it_is_called(by: str) -> None:
    found = clips(10)
    found[8] = replace(found[8], about=found[0].about)
    said = (
        "0.mp4 and 8.mp4 are the same clip, and would be in what is scored and in what is trained"
    )
    with pytest.raises(InputError, match=said):
        roles(found, by)
    found[8] = clips(10)[8]
    found[2] = replace(found[2], about=found[1].about)  # held out, to stop by
    with pytest.raises(InputError, match="1.mp4 and 2.mp4 are the same clip"):
        roles(found, by)


def test_the_same_clip_twice_in_one_split_is_none() -> None:
    found = clips(10, take=[0, 1, 2, 3, 4, 5, 6, 7, 0, 9])
    found[8] = replace(found[8], about=found[0].about)
    assert roles(found, "take")[0] == roles(found, "take")[8]


def test_every_clip_is_cut_in_time() -> None:
    split = split_of(clips(3), None, 1, 0.6, "time")  # type: ignore[arg-type]
    assert split.known == (60, 60, 60) and split.asked == (60, 60, 60)
    for train, held, scored in zip(split.train, split.held_out, split.scored, strict=True):
        assert sorted([*train.tolist(), *held.tolist(), *scored.tolist()]) == list(range(FRAMES))
        assert int(train.max()) < 60 <= int(scored.min())
    one = split_times([FRAMES], [FRAMES], 1, 0.6)
    assert torch.equal(one.train[0], split.train[1])


def test_groups_are_counted_not_clips() -> None:
    assert roles_by_group(["a"] * 6 + ["b", "c", "d"], 0.5) == ["train"] * 6 + [
        "held_out",
        "scored",
        "scored",
    ]
