"""A bar cannot be met where something failed: failures are planted under every row there is."""

import math
from dataclasses import replace

import pytest

from vidphys.experiments.catalogue import TABLES
from vidphys.experiments.core import bars

SEEDS = (100, 101, 102)
EPISODES = 64
HELD = [(name, row) for name in TABLES for row in bars.rows_of(name) if row.bar]
RATIOS = [(name, row) for name, row in HELD if row.divided_by]
READINGS = {"<=": 0.5, "<": 0.5, ">=": 2.0, ">": 2.0}  # of the bar, where it is met


def record(row, cell, seed, value):
    return {
        "cell": cell,
        "metric": row.metric,
        "coupling": row.coupling,
        "horizon": row.horizon,
        "readout": row.readout or "none",
        "seed": seed,
        "value": value,
        "status": "ok",
        "episodes": EPISODES,
        "nonfinite": 0,
    }


def sound(row):
    """Records under which a row's bar is met on every seed."""
    sign, number = row.bar.split()
    bar, step = float(number), 1.0 if sign[0] == ">" else -1.0
    value = bar * READINGS[sign] if bar > 0 else bar + step
    found = [record(row, row.cell, seed, value) for seed in SEEDS]
    if row.divided_by:
        found += [record(row, row.divided_by, seed, 1.0) for seed in SEEDS]
    return found


def planted(records, seed, cell, **change):
    return [{**r, **change} if (r["seed"], r["cell"]) == (seed, cell) else dict(r) for r in records]


def without(records, seed, cell):
    return [r for r in records if (r["seed"], r["cell"]) != (seed, cell)]


FAILURES = {
    "lost seed": without,
    "NaN": lambda r, s, c: planted(r, s, c, value=math.nan),
    "infinite": lambda r, s, c: planted(r, s, c, value=math.inf),
    "minus infinity": lambda r, s, c: planted(r, s, c, value=-math.inf),
    "null": lambda r, s, c: planted(r, s, c, value=None),
    "failed": lambda r, s, c: planted(r, s, c, value=None, status="failed"),
    "void": lambda r, s, c: planted(r, s, c, status="void"),
}


def named(cases):
    return [f"{name}: {row.what}" for name, row in cases]


@pytest.mark.parametrize(("table", "row"), HELD, ids=named(HELD))
def test_every_row_is_met_by_sound_records_and_missed_by_each_planted_failure(table, row):
    records = sound(row)
    good = bars.judge(row, records, SEEDS)
    assert (good.verdict, good.why, good.lost) == (bars.MET, "", {})
    cells = [row.cell, *([row.divided_by] if row.divided_by else [])]
    for name, plant in FAILURES.items():
        for cell in cells:
            for seed in SEEDS:
                found = bars.judge(row, plant(records, seed, cell), SEEDS)
                assert found.verdict == bars.MISSED, (name, cell)
                assert f"seed {seed}: " in found.why and seed not in found.values
                # The others keep their numbers, and stand beside it.
                assert set(found.values) == set(SEEDS) - {seed}
        for cell in cells:
            every = records
            for seed in SEEDS:
                every = plant(every, seed, cell)
            found = bars.judge(row, every, SEEDS)
            assert (found.verdict, found.value) == (bars.MISSED, None), (name, cell)
            assert all(f"seed {seed}: " in found.why for seed in SEEDS)


@pytest.mark.parametrize(("table", "row"), RATIOS, ids=named(RATIOS))
@pytest.mark.parametrize("zero", [0.0, -0.0, 5e-324])
def test_a_ratio_over_zero_is_a_miss_that_names_the_cell(table, row, zero):
    records = planted(sound(row), 101, row.divided_by, value=zero)
    records = planted(records, 101, row.cell, value=1e300)
    found = bars.judge(row, records, SEEDS)
    assert found.verdict == bars.MISSED and set(found.values) == {100, 102}
    assert f"seed 101: {row.divided_by}: " in found.why


def bounded(row):
    return row.bar[0] == "<"


@pytest.mark.parametrize(("table", "row"), HELD, ids=named(HELD))
def test_episodes_lost_miss_the_bar_wherever_they_flatter_it(table, row):
    records = sound(row)
    mine = bars.judge(row, planted(records, 102, row.cell, nonfinite=3), SEEDS)
    assert mine.lost == {102: (3, EPISODES)}
    fails_by_claim = not bounded(row) and any(word in row.metric for word in bars.ERRORS)
    assert mine.verdict == (bars.MET if fails_by_claim else bars.MISSED)
    assert ("seed 102: 3 of 64 episodes lost" in mine.why) != fails_by_claim
    if row.divided_by and not bounded(row):
        found = bars.judge(row, planted(records, 102, row.divided_by, nonfinite=3), SEEDS)
        assert found.verdict == bars.MISSED and found.lost == {102: (3, EPISODES)}
        assert f"seed 102: {row.divided_by}: 3 of 64 episodes lost" in found.why


def test_no_row_on_bounded_drift_or_inversion_lets_an_episode_go():
    rows = [r for _, r in HELD if bounded(r) and ("drift" in r.metric or "inversion" in r.metric)]
    assert len(rows) > 20
    for row in rows:
        found = bars.judge(row, planted(sound(row), 100, row.cell, nonfinite=1), SEEDS)
        assert found.verdict == bars.MISSED


ROW = bars.Row("N1", "a thing", "a", "m", bar="<= 2")


def test_only_a_cell_that_was_not_asked_for_or_was_skipped_has_no_number():
    assert bars.judge(ROW, []) == bars.Verdict(ROW, {}, None, bars.ABSENT, "not recorded")
    lost = bars.judge(ROW, [], (0, 1))
    assert (lost.verdict, lost.why) == (bars.MISSED, "seed 0: no record; seed 1: no record")
    skipped = [{**record(ROW, "a", 0, None), "status": bars.SKIPPED}]
    assert bars.judge(ROW, skipped, (0,)).verdict == bars.ABSENT
    assert bars.judge(ROW, skipped, (0, 1)).verdict == bars.MISSED
    assert bars.judge(ROW, [*skipped, record(ROW, "a", 1, 1.0)], (0, 1)).verdict == bars.MISSED


def test_a_row_that_only_reports_says_what_is_lost():
    row = replace(ROW, bar="")
    records = [record(row, "a", 0, 1.0), {**record(row, "a", 1, 3.0), "nonfinite": 2}]
    found = bars.judge(row, records, (0, 1, 2))
    assert (found.verdict, found.value) == (bars.REPORTED, 2.0)
    assert found.why == "seed 1: 2 of 64 episodes lost; seed 2: no record"
    assert bars.judge(row, [], (0,)).verdict == bars.ABSENT


def test_a_seed_that_failed_once_is_not_mended_by_a_second_record():
    again = [{**record(ROW, "a", 0, None), "status": "failed"}, record(ROW, "a", 0, 1.0)]
    fewer = [{**record(ROW, "a", 0, 1.0), "nonfinite": 3}, record(ROW, "a", 0, 1.0)]
    for records in (again, again[::-1], fewer, fewer[::-1]):
        assert bars.judge(ROW, records, (0,)).verdict == bars.MISSED


def test_a_ratio_asks_for_the_seeds_of_its_own_cell_only():
    row = replace(ROW, divided_by="b")
    records = [record(row, "a", 0, 1.0), *(record(row, "b", seed, 1.0) for seed in (0, 1))]
    assert bars.judge(row, records, (0,)).verdict == bars.MET
    assert bars.judge(row, records).verdict == bars.MISSED  # nobody said which were asked for


@pytest.mark.parametrize(("values", "middle"), [((1, 2, 4, 9), 3.0), ((1, 2, 9), 2.0)])
def test_the_median_of_an_even_number_of_seeds_lies_midway(values, middle):
    row = replace(ROW, over="median")
    found = bars.judge(row, [record(row, "a", s, float(v)) for s, v in enumerate(values)])
    assert found.value == middle
