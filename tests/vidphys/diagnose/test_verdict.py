"""What a recording must show before its law is called explained."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from vidphys.diagnose.explanations.forecast import Validation
from vidphys.diagnose.explanations.mechanism import ByMechanism
from vidphys.diagnose.explanations.menu import ByMenu
from vidphys.diagnose.explanations.verdict import EXPLAINED, MOSTLY, NOT, judge
from vidphys.diagnose.telling.report import _status

TIMES = np.arange(40) * 0.05


def tail(miss: float) -> Validation:
    """A body on a circle of one unit, foretold with an error of ``miss`` units."""
    seen = np.stack([np.cos(TIMES), np.sin(TIMES)], -1)[:, None]
    off = {"model": np.array([miss, 0.0]), "persistence": seen[0] - seen}
    errors = {name: float(np.sqrt((by**2).sum(-1).mean())) for name, by in off.items()}
    return Validation(TIMES, seen, {name: seen + by for name, by in off.items()}, errors, seen[0])


@pytest.mark.parametrize(
    ("share", "left", "miss", "status"),
    [
        (0.9999, 0.01, 0.02, EXPLAINED),
        (0.97, 0.17, 0.05, MOSTLY),
        (0.9999, 0.01, 0.5, NOT),
        (0.91, 0.3, 0.6, NOT),  # within three times of what is left, which is too much to count
        (0.5, 0.7, 0.01, NOT),
    ],
)
def test_a_law_is_believed_by_its_share_and_by_what_it_foretells(
    share: float, left: float, miss: float, status: str
) -> None:
    assert judge(share, left, 1.0, tail(miss)).status == status


def test_what_is_left_counts_as_noise_only_where_the_law_has_all_of_the_motion() -> None:
    assert judge(0.995, 0.1, 0.5, tail(0.25)).horizon == pytest.approx(TIMES[-1])
    assert judge(0.95, 0.1, 0.5, tail(0.25)).horizon == 0.0


@pytest.mark.parametrize(
    ("off", "status"),
    [
        ([(4, 7, 0.22)], MOSTLY),  # beyond a tenth of the spread in three frames of forty
        ([(4, 9, 0.22)], NOT),  # in five
        ([(2, 7, 0.12), (38, 40, 0.22)], NOT),  # in three, with the last: does it come back?
    ],
)
def test_a_law_that_is_off_for_a_few_frames_and_comes_back_is_mostly_right(off, status) -> None:
    held = tail(0.0)
    model = held.forecasts["model"].copy()
    for first, stop, by in off:
        model[first:stop, :, 0] += by
    forecasts = {**held.forecasts, "model": model}
    found = judge(
        0.9999,
        0.001,
        1.0,
        replace(held, forecasts=forecasts, errors={**held.errors, "model": 0.1}),
    )
    assert found.status == status and found.horizon < TIMES[-1] / 3


@pytest.mark.parametrize(
    ("miss", "moves", "status"),
    [
        (0.05, True, MOSTLY),  # near all the time, though going straight on is nearer
        (0.25, True, NOT),
        (0.05, False, NOT),  # so is a body that stays where it was
    ],
)
def test_what_goes_straight_on_in_the_end_is_no_word_against_a_law_that_foretells_it(
    miss: float, moves: bool, status: str
) -> None:
    held = tail(miss)
    if not moves:
        seen = np.zeros_like(held.seen)
        forecasts = {name: path - held.seen for name, path in held.forecasts.items()}
        held = replace(held, seen=seen, last=seen[0], forecasts=forecasts)
    held.forecasts["constant velocity"] = held.seen
    held.errors["constant velocity"] = 0.0
    assert judge(0.9999, 0.001, 1.0, held).status == status


def test_the_error_of_a_short_flight_is_taken_frame_by_frame() -> None:
    """It doubles within the frames over which that of a long one is averaged."""
    long, short = tail(0.0), np.arange(8.0)
    off = np.minimum(0.003 * 4 ** np.arange(8.0), 0.8)
    model = long.seen[:8] + off[:, None, None] * [1.0, 0.0]
    forecasts = {name: path[:8] for name, path in long.forecasts.items()} | {"model": model}
    errors = {**long.errors, "model": float(np.sqrt((off**2).mean()))}
    held = replace(long, times=short, seen=long.seen[:8], forecasts=forecasts, errors=errors)
    assert judge(0.9999, 0.001, 1.0, held).horizon == 3.0


@pytest.mark.parametrize(
    ("kinds", "miss", "sought", "status"),
    [
        ({"centre"}, 0.02, False, EXPLAINED),
        ({"centre"}, 0.17, False, NOT),  # the same miss is enough where less can be bent
        ({"arc"}, 0.17, False, MOSTLY),
        ({"arc"}, 0.02, False, EXPLAINED),
        ({"arc"}, 0.02, True, MOSTLY),  # what was held out had a say in what is fitted
    ],
)
def test_a_place_that_nobody_sees_has_to_foretell_everything(
    kinds: set[str], miss: float, sought: bool, status: str
) -> None:
    late = tail(0.0)
    late.forecasts["model"][25:] += miss
    found = SimpleNamespace(kinds=kinds, share=0.9999, left=0.001, spread=1.0)
    law = SimpleNamespace(
        before=found,
        _period=np.inf,
        _bent=False,
        impossible="",
        unfollowed={},
        sought=sought,
        _late=False,
        in_step=[],
        balanced=None,
        whole=SimpleNamespace(groups=()),
    )
    for held in (late.forecasts, late.errors):
        held["constant velocity"] = held["persistence"]
    assert ByMechanism._judged(law, late).status == status


@pytest.mark.parametrize(
    ("kinds", "status"),
    [({"dry"}, EXPLAINED), ({"uniform"}, EXPLAINED), ({"dry", "trap"}, MOSTLY)],
)
def test_dry_friction_or_a_pull_alone_is_not_beaten_by_a_constant_force(kinds, status) -> None:
    held = tail(0.02)
    half_off = held.seen + (held.forecasts["model"] - held.seen) / 2
    held.forecasts["constant acceleration"] = half_off
    held.errors["constant acceleration"] = held.errors["model"] / 2
    found = SimpleNamespace(kinds=kinds, share=0.9999, left=0.001, spread=1.0)
    law = SimpleNamespace(
        before=found,
        _period=np.inf,
        _bent=False,
        impossible="",
        unfollowed={},
        sought=False,
        _late=False,
        in_step=[],
        balanced=None,
        whole=SimpleNamespace(groups=()),
    )
    assert ByMechanism._judged(law, held).status == status


@pytest.mark.parametrize(
    ("kicks", "camera", "status"),
    [(0.3, True, MOSTLY), (0.3, False, EXPLAINED), (0.0, True, MOSTLY)],
)
def test_the_menu_is_never_sure_of_a_picture_where_kicks_may_be_who_follows_it(
    kicks: float, camera: bool, status: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = SimpleNamespace(sure=True, explained=True)
    bath = ByMenu(told, SimpleNamespace(kicks=kicks), None, 10, camera)
    for name in ("verdict", "strays", "stays"):  # nothing was held out that it could foretell
        monkeypatch.setattr(ByMenu, name, None if name == "verdict" else False)
    assert bath.jolted is (camera and kicks > 0)
    assert _status(bath) == status and bath.explained
