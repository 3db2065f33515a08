"""The matrix of extremes: verdicts, figures, the verb; a wrong integrator is found out."""

from __future__ import annotations

import json
import math
import re
import warnings
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import torch

from dynamics import INTEGRATORS, EnergyWarning, PhaseState
from dynamics.integrators import Integrator
from tests.shared.serial import serially
from vidphys.cli import main
from vidphys.runs import pool
from vidphys.runs.tasks import WorkerLost
from vidphys.stress import balance, baths, compiled, contacts, inputs, methods, orbits, pictures
from vidphys.stress.bodies import Orbit, invariant_error
from vidphys.stress.case import REFUSED, SILENT, SKIPPED, SOUND, WARNED, Case, Skip
from vidphys.stress.figures import MET, MISSED, NOT_MEASURED, PARTLY, PROMISES, figure_rows
from vidphys.stress.matrix import PRESETS, families
from vidphys.stress.verdict import judge


def cell(run, bound: float = 1.0, **options) -> Case:
    return Case("axis", "system", "extreme", 1.0, run, bound, **options)


def warned_of() -> float:
    warnings.warn("energy is lost", EnergyWarning, stacklevel=1)
    return 5.0


def other_warning() -> float:
    warnings.warn("something else", RuntimeWarning, stacklevel=1)
    return 5.0


def no_means() -> float:
    raise Skip("no such device here")


def stumbles() -> float:
    return float(torch.ones(2) @ torch.ones(3))


@pytest.mark.parametrize(
    ("run", "verdict"),
    [
        (lambda: 0.5, SOUND),
        (lambda: 2.0, SILENT),
        (lambda: math.nan, SILENT),
        (lambda: math.inf, SILENT),
        (warned_of, WARNED),
        (other_warning, SILENT),  # a warning that is not ours names nothing
        (no_means, SKIPPED),
        (stumbles, SILENT),  # a library that stumbles is no refusal
        (lambda: Orbit(0.0, 0.0).law("leapfrog"), REFUSED),
    ],
)
def test_verdicts(run, verdict: str) -> None:
    assert judge(cell(run)).verdict == verdict


def test_a_wrong_integrator_is_silently_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that gains energy slowly enough for no warning, in a cell with a tighter bound."""

    def gaining(field, state, dt, memory):
        after, memory = INTEGRATORS["leapfrog"].advance(field, state, dt, memory)
        return PhaseState(after.q, after.p * (1 + 2e-6)), None

    wrong = Integrator("wrong", 2, True, 1, True, gaining)
    monkeypatch.setitem(INTEGRATORS, "wrong", wrong)
    found = {}
    for name in ("leapfrog", "wrong"):
        start, params = Orbit(0.0, 0.1).start(torch.float64)
        run = partial(invariant_error, Orbit(0.0, 0.1).law(name), start, params, 300)
        found[name] = judge(cell(run, 1e-4)).verdict
    assert found == {"leapfrog": SOUND, "wrong": SILENT}


def test_a_wrong_order_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def euler(field, state, dt, memory):
        p = state.p + dt * field.force(state.q, state.p)
        return PhaseState(state.q + dt * field.velocity(state.q, p), p), None

    case = next(c for c in methods.methods() if c.figure == "A1")
    monkeypatch.setitem(INTEGRATORS, "leapfrog", Integrator("leapfrog", 2, True, 1, True, euler))
    assert judge(case).verdict == SILENT


def test_the_standard_preset_has_the_promised_cells() -> None:
    cells = [case for family in families(PRESETS["standard"]).values() for case in family]
    assert len(cells) >= 600
    assert max(Counter(case.name for case in cells).values()) == 1
    assert {c.figure for c in cells} - {""} == set(PROMISES)
    quick = families(PRESETS["quick"])
    assert sum(len(family) for name, family in quick.items() if name != "foreign") < 360


def test_figures_are_met_missed_or_not_measured() -> None:
    good = judge(cell(lambda: 0.5, figure="A1", must=(SOUND,)))
    bad = judge(cell(warned_of, figure="A2", must=(SOUND,)))
    skipped = judge(cell(no_means, figure="A24"))
    there = judge(cell(lambda: 0.5, figure="A3", must=(SOUND,)))
    absent = judge(cell(no_means, figure="A3"))
    rows = {row.name: row for row in figure_rows([good, bad, skipped, there, absent])}
    assert len(rows) == 30
    assert rows["A3"].verdict == PARTLY and "no such device" in rows["A3"].why
    assert rows["A1"].verdict == MET
    assert rows["A2"].verdict == MISSED and "warned" in rows["A2"].why
    assert rows["A24"].verdict == NOT_MEASURED and "no such device" in rows["A24"].why


@pytest.mark.parametrize(
    "family",
    [
        baths.friction,
        baths.drive,
        contacts.coincidence,
        inputs.inputs,
        pictures.readings,
    ],
)
def test_cheap_families_are_as_their_figures_ask(family) -> None:
    for case in list(family())[::5]:
        outcome = judge(case)
        assert outcome.verdict != SILENT and outcome.allowed, outcome


def test_compiled_laws_are_their_networks_or_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "FITS", 30)
    wanted = (
        "from rest",
        "circle, G = -1",
        "distances times 100",
        "100 times those of training",
    )
    fast = compiled.Fast(compiled.Learned("factored-radial"), "numba", "float64")
    radial = {c.extreme: c for c in compiled.cells(fast)}
    found = {extreme: judge(radial[extreme]) for extreme in wanted}
    assert [found[name].verdict for name in wanted] == [SOUND, SOUND, SOUND, WARNED]
    with torch.no_grad():
        fast.head.potential.table.mul_(1 + 1e-4)  # a spline that is off
    fast.head.packed.clear()
    assert judge(radial["from rest"]).verdict == SILENT


def test_a_rate_is_right_or_its_interval_is_wide(monkeypatch: pytest.MonkeyPatch) -> None:
    cases = {(c.system[-3:], c.extreme): c for c in balance.energy_balance()}
    assert judge(cases["0.3", "0.04 s, noise 0, seed 0"]).verdict == SOUND
    unresolved = cases["0.1", "0.08 s, noise 0, seed 0"]
    assert judge(unresolved).verdict == WARNED

    monkeypatch.setattr(balance, "corrected_rate", partial(_narrow, balance.corrected_rate))
    assert judge(unresolved).verdict == SILENT


def _narrow(estimate, motion, potential):
    found = estimate(motion, potential)
    return replace(found, low=found.value - 0.01, high=found.value + 0.01)


@pytest.mark.parametrize("shape", ["circle", "plunge"])
def test_softened_orbits_are_sound_or_warned_of(shape: str) -> None:
    cases = [c for c in orbits.softening() if shape in c.extreme and c.integrator == "leapfrog"]
    for case in (cases[0], cases[3]):  # softening 0.1 and 0.01
        orbit, name, dtype, _, dt, episodes = case.run.args
        short = replace(case, run=partial(case.run.func, orbit, name, dtype, 100, dt, episodes))
        assert judge(short).verdict in (SOUND, WARNED)


def rows(run: Path) -> list[dict]:
    kept = pq.read_table(run / "records.parquet").to_pylist()
    return [{k: v for k, v in row.items() if k != "seconds"} for row in kept]


def test_two_workers_record_what_one_process_does(tmp_path, monkeypatch) -> None:
    command = ["stress", "--axes", "drive", "input", "--quiet", "--out"]
    assert main([*command, str(tmp_path / "two"), "--workers", "2"]) == 0
    monkeypatch.setattr(pool, "run_all", serially)
    assert main([*command, str(tmp_path / "alone")]) == 0
    assert rows(tmp_path / "two") == rows(tmp_path / "alone")
    for run in ("two", "alone"):
        logs = {log.stem: log.read_text() for log in (tmp_path / run / "logs").iterdir()}
        assert logs.keys() == {"drive", "input"}
        assert all("\ndone: " in re.sub(r"(?m)^\S+ ", "", log) for log in logs.values())


def lost_at_coincidence(work, tasks, workers, show, finished, cards):
    failures = serially(work, tasks[1:], workers, show, finished)
    return [(0, WorkerLost("killed")), *((n + 1, error) for n, error in failures)]


def test_a_family_whose_process_is_lost_is_named_and_the_others_are_judged(
    tmp_path, monkeypatch, capsys
) -> None:
    command = ["stress", "--out", str(tmp_path / "run"), "--axes", "drive", "coincidence"]
    monkeypatch.setattr(pool, "run_all", lost_at_coincidence)
    assert main([*command, "--quiet"]) == 1
    assert "coincidence failed: WorkerLost" in capsys.readouterr().err
    assert {row["grounding"] for row in rows(tmp_path / "run")} == {"drive"}
    monkeypatch.setattr(pool, "run_all", serially)
    assert main([*command, "--quiet"]) == 0
    assert {row["grounding"] for row in rows(tmp_path / "run")} == {"drive", "coincidence"}


def test_the_verb_writes_records_verdicts_figures_and_a_report(
    tmp_path, capsys, monkeypatch
) -> None:
    monkeypatch.setattr(pool, "run_all", serially)
    command = ["stress", "--out", str(tmp_path / "run"), "--axes", "drive", "--quiet"]
    assert main(command) == 0
    assert "figures A1-A30" in capsys.readouterr().out
    verdicts = json.loads((tmp_path / "run" / "verdicts.json").read_text())
    records = pq.read_table(tmp_path / "run" / "records.parquet").to_pylist()
    assert len(verdicts["figures"]) == 30
    assert SILENT not in verdicts["counts"]
    assert {row["dtype"] for row in records} >= {"float32"}  # each has its precision
    assert sum(row["metric"] == "error" for row in records) == len(verdicts["cells"])
    report = (tmp_path / "run" / "report.html").read_text()
    assert (
        "The reliability figures" in report and report.count("<svg") == 2
    )  # all cells, and the axis
    assert main(command) == 0  # goes on where it was


def test_the_verb_fails_where_a_cell_is_silently_wrong(tmp_path, monkeypatch, capsys) -> None:
    wrong = cell(lambda: 2.0)
    monkeypatch.setattr("vidphys.stress.matrix.baths.drive", lambda: iter([wrong]))
    monkeypatch.setattr(pool, "run_all", serially)
    assert main(["stress", "--out", str(tmp_path / "run"), "--axes", "drive", "--quiet"]) == 1
    assert "silently wrong: axis/system" in capsys.readouterr().err


def test_an_unknown_axis_is_refused(tmp_path, capsys) -> None:
    assert main(["stress", "--out", str(tmp_path / "run"), "--axes", "colour"]) == 2
    assert "no axis 'colour'" in capsys.readouterr().err
