"""A video in memory: one order of axes whatever it comes in, and a clear word where it is wrong."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import vidphys
from encoders.frozen.catalogue import load_encoder
from tests.shared.small_clips import cells  # noqa: F401

T, H, W = 5, 12, 20
FILM = np.random.default_rng(0).integers(0, 256, (T, H, W, 3), np.uint8)
TIMES = [0.0, 0.1, 0.2, 0.3, 0.4]


@pytest.fixture(autouse=True)
def encoder(cells):  # noqa: ANN001, ANN201, F811
    return cells


def values(frames, times=TIMES, **more) -> torch.Tensor:
    return vidphys.encode_video(frames, times, "cells", **more).values


def test_every_order_of_axes_gives_the_same_features() -> None:
    wanted = load_encoder("cells", {})(
        torch.from_numpy(FILM).permute(0, 3, 1, 2)[None], torch.tensor(TIMES)
    ).values
    assert torch.equal(values(FILM), wanted)
    assert torch.equal(values(FILM.transpose(0, 3, 1, 2)), wanted)
    assert torch.equal(values(FILM[None]), wanted)
    assert torch.equal(values(torch.from_numpy(FILM)), wanted)
    assert torch.equal(values([*FILM], np.array(TIMES)), wanted)
    assert torch.equal(values(FILM, torch.tensor(TIMES), layout="thwc"), wanted)
    torch.testing.assert_close(values(FILM.astype(np.float64) / 255), wanted)
    both = np.stack([FILM, FILM[:, ::-1]])
    assert torch.equal(values(both)[0], wanted[0])
    assert torch.equal(values(np.moveaxis(both, -1, 2)), values(both))


def test_sizes_that_leave_doubt_are_asked_about() -> None:
    narrow = np.ascontiguousarray(FILM[:, :3])
    with pytest.raises(ValueError, match="both ends could be channels; say which axis"):
        values(narrow)
    assert values(narrow.repeat(4, 1), layout="thwc").shape[1] == T


def test_more_than_three_channels_only_on_request() -> None:
    bodies = np.random.default_rng(1).random((T, 4, H, W))
    with pytest.raises(ValueError, match="no axis has 1 or 3 channels; say which axis is what"):
        values(bodies)
    with pytest.raises(ValueError, match="4 channels in .* wants 1 or 3: leave an alpha channel"):
        values(bodies, layout="tchw")
    assert values(bodies, layout="tchw", bodies=True).shape[1] == T


@pytest.mark.parametrize(
    ("frames", "times", "words"),
    [
        (FILM, TIMES[:4], r"`times` \(4,\) for 5 frames; give the seconds of each"),
        (FILM, 25.0, r"`times` \(\) for 5 frames"),
        (FILM, TIMES[::-1], "must be finite and rise"),
        (FILM, [0, 1, np.nan, 3, 4], "must be finite and rise"),
        (FILM, ["a", "b", "c", "d", "e"], "holds <U1; give the seconds of each frame"),
        (FILM.astype(np.int64), TIMES, "of int64; wants uint8 from 0 to 255, or floats"),
        (FILM > 100, TIMES, "of bool; wants uint8"),
        (FILM.astype(float), TIMES, "from 0 to 255; wants floats from 0 to 1: divide by 255"),
        (FILM / 255 * np.nan, TIMES, "from nan to nan; wants floats from 0 to 1"),
        (FILM[0], TIMES, r"\(12, 20, 3\) has 3 axes; wants uint8"),
        (FILM[:0], [], r"\(0, 12, 20, 3\) holds nothing"),
        ([FILM[0], FILM[1, :5]], TIMES, "of unequal sizes"),
        ("film.mp4", TIMES, "holds <U8, not numbers; wants uint8"),
    ],
)
def test_what_is_wrong_is_said_with_what_was_expected(frames, times, words: str) -> None:
    with pytest.raises(ValueError, match=words) as caught:
        values(frames, times)
    assert "\n" not in str(caught.value)


def test_a_layout_that_does_not_fit() -> None:
    with pytest.raises(ValueError, match=r"has 4 axes, not bthwc"):
        values(FILM, layout="bthwc")
    with pytest.raises(ValueError, match="`layout` 'hwc'; use one of thwc, tchw"):
        values(FILM, layout="hwc")


def test_an_encoder_itself_refuses_channels_that_come_last() -> None:
    with pytest.raises(ValueError, match=r"\(1, 5, 12, 20, 3\) have their channels last"):
        load_encoder("cells", {})(torch.from_numpy(FILM)[None], torch.tensor(TIMES))
