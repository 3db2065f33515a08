"""Whether a clip is like those of a training: its features, its readout's doubt, its physics."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from binders.tracks import Tracks
from dynamics import Parameters, PhaseState, build, rollout, terms
from readouts.attention import confidence_at
from vidphys.data.charts import Plane
from vidphys.data.splits import split_clips
from vidphys.reading.clip_dynamics import FACTORED, Dynamics, Followed
from vidphys.reading.familiar import (
    AHEAD,
    CONTEXT,
    DOUBT,
    FEATURES,
    PHYSICS,
    RATE,
    Familiar,
    Limit,
    familiar_of,
    stretches,
)
from vidphys.reading.memory import FeatureMemory

INTERVAL = 0.1
LAW = Parameters(torch.ones(1), torch.ones(1, 1))
FRAMES = 30


def trapped(stiffness: float = 4.0) -> Dynamics:
    """The exact law of a body in a trap."""
    term = terms.Hamiltonian(potentials=(terms.Trap(stiffness=stiffness),))
    head = build(term, 1, 0.01, 2).eval()
    return Dynamics(Plane(), INTERVAL, {FACTORED: term}, {FACTORED: head})


def path(seed: int, dynamics: Dynamics, doubt: float = 1e-3) -> Followed:
    """Of a body that the law moves, from a drawn start."""
    rng = torch.Generator().manual_seed(seed)
    start = PhaseState(*(torch.randn(1, 1, 2, generator=rng) for _ in range(2)))
    states = rollout(dynamics.heads[FACTORED], start, LAW, 10 * FRAMES, 0.01).states
    q = states.q[:, : 10 * FRAMES : 10].double().detach()
    noisy = q + 1e-3 * torch.randn(q.shape, generator=rng)
    sure = confidence_at(torch.full(q.shape[:3], doubt) * (1 + torch.rand(q.shape[:3])))
    times = INTERVAL * torch.arange(FRAMES, dtype=torch.float64)
    return Followed(Tracks(noisy, sure, times), LAW)


@pytest.fixture(scope="module")
def known() -> Familiar:
    """Of 30 clips, 10 of which were only scored."""
    roles = ["train"] * 19 + ["held_out"] + ["scored"] * 10
    split = split_clips([FRAMES] * 30, [FRAMES] * 30, 1, roles)
    maps = [normal(FRAMES, k) for k in range(30)]
    return familiar_of(maps, split, [path(k, trapped()) for k in range(30)], trapped())


def normal(n: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(n, 6, 3, 4, generator=torch.Generator().manual_seed(seed))


def test_a_memory_knows_what_it_has_seen_and_the_strangest_cell_counts():
    maps = 3 * normal(20) + 5
    memory = FeatureMemory.of([maps[:8], maps[8:]])  # 240 cells: all are kept
    assert memory.distance(maps) == pytest.approx(torch.zeros(20), abs=1e-3)
    strange = maps[:2].clone()
    strange[1, :, 2, 3] += 30  # ten standard deviations in each channel
    near = (strange[1, :, 2, 3] - maps.movedim(1, -1).flatten(0, -2)).norm(dim=-1).min()
    found = memory.distance(strange)
    assert float(found[0]) < 1e-3
    assert float(found[1]) == pytest.approx(float(near) / 3 / 6**0.5, rel=0.1)


def test_what_is_rare_is_kept_where_much_is_left_out(monkeypatch):
    """A body is a few cells of thousands."""
    monkeypatch.setattr("vidphys.reading.memory.KEPT", 20)
    maps = 0.1 * normal(400)
    maps[7, :, 1, 1] += 9
    memory = FeatureMemory.of([maps])
    assert len(memory.kept) == 20
    assert float(memory.distance(maps[7:8])) < 1.1 * float(memory.distance(maps).max())
    other = maps[7:8].clone()
    other[0, :, 1, 1] -= 4.5  # half as bright as any that was seen
    assert float(memory.distance(other)) > 3 * float(memory.distance(maps).max())
    with pytest.raises(ValueError, match="`maps`"):
        FeatureMemory.of([])


def test_of_many_clips_each_counts_for_as_much(monkeypatch):
    monkeypatch.setattr("vidphys.reading.memory.SEEN", 300)
    memory = FeatureMemory.of(torch.full((25, 1, 4, 4), float(k)) for k in range(20))
    assert float(memory.mean) == pytest.approx(9.5, abs=1)  # three standard errors


@given(st.integers(1, 300), st.integers(0, 5))
def test_a_limit_is_exceeded_as_seldom_as_it_says(n, seed):
    """By exchangeability: of n + 1 numbers in any order, the last is beyond the others' limit."""
    values = torch.rand(n + 1, generator=torch.Generator().manual_seed(seed)).double()
    beyond = sum(
        bool(values[k] > Limit.of(torch.cat([values[:k], values[k + 1 :]])).value)
        for k in range(n + 1)
    )
    rate = Limit.of(values[:n]).rate
    assert beyond / (n + 1) <= rate + 1e-12
    assert rate <= max(RATE, 1 / (n + 1)) + 1e-12


def test_a_clip_of_the_same_kind_raises_nothing_and_limits_say_their_rate(known):
    assert set(known.limits) == {FEATURES, DOUBT, PHYSICS}
    raised = 0
    for seed in range(100, 112):
        strange = known.memory.distance(normal(FRAMES, seed))
        flags = known.flags(strange, path(seed, trapped()), trapped())
        assert [flag.name for flag in flags] == [FEATURES, DOUBT, PHYSICS]
        raised += sum(flag.raised for flag in flags)
    assert raised == 0
    assert all(0 < limit.rate <= RATE for limit in known.limits.values())


@pytest.mark.parametrize("name", [FEATURES, DOUBT, PHYSICS])
def test_each_change_raises_its_own_flag_and_no_other(known, name):
    maps = normal(FRAMES, 200)
    if name == FEATURES:
        maps[:, :, 1, 1] += 3  # one cell of twelve, in every frame
    # another law, the same doubt; or the same law, read with ten times the doubt
    moved = path(200, trapped(8.0 if name == PHYSICS else 4.0), 1e-2 if name == DOUBT else 1e-3)
    flags = known.flags(known.memory.distance(maps), moved, trapped())
    assert [flag.name for flag in flags if flag.raised] == [name]
    (flag,) = (flag for flag in flags if flag.raised)
    assert f"{flag.value / flag.limit.value:.3g} times" in str(flag)


def test_a_clip_that_is_too_short_for_the_law_is_judged_by_what_is_left(known):
    short = Followed(
        Tracks(
            *(x[:, :5] for x in vars(path(0, trapped()).track).values() if x.dim() > 1),
            torch.arange(5.0) * INTERVAL,
        ),
        LAW,
    )
    flags = known.flags(known.memory.distance(normal(5)), short, trapped())
    assert [flag.name for flag in flags] == [FEATURES, DOUBT]


def test_only_frames_from_the_first_scored_one_on_are_looked_at():
    """The part before was trained on, and says nothing of other clips."""
    dynamics, first = trapped(), FRAMES - 4 * AHEAD
    clip = path(1, dynamics)
    found = stretches(torch.ones(FRAMES - first), clip, dynamics, first)
    assert {name: len(values) for name, values in found.items()} == dict.fromkeys(found, 4)
    clip.track.positions[:, : first - CONTEXT] += 5.0
    clip.track.confidence[:, :first] /= 10
    again = stretches(torch.ones(FRAMES - first), clip, dynamics, first)
    assert torch.equal(found[DOUBT], again[DOUBT])
    torch.testing.assert_close(found[PHYSICS], again[PHYSICS], atol=0.01, rtol=0)
    assert float(found[PHYSICS].max()) < 0.05


def test_features_that_stand_for_several_frames_have_stretches_as_long():
    clip = path(1, trapped())
    found = stretches(torch.arange(15.0), clip, trapped())
    assert found[FEATURES].tolist() == [0.5, 2.5, 4.5, 6.5, 8.5, 10.5, 12.5]
    assert not math.isnan(float(found[DOUBT].sum()))
