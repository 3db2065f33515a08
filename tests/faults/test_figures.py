"""F1 to F14 are each held by a test that says its number; F13: the share of mutants is told."""

from __future__ import annotations

import re
from pathlib import Path

from tests.mutation import __main__ as mutation

ROOT = Path(__file__).parents[1]


def test_every_figure_from_f1_to_f14_is_in_the_name_of_a_test():
    texts = [p.read_text() for room in ("faults", "hostile") for p in (ROOT / room).glob("*.py")]
    names = re.findall(r"def (test_\w+)", "\n".join(texts))
    held = {int(number) for name in names for number in re.findall(r"_f(\d+)(?=_)", name)}
    assert held == set(range(1, 15))


def test_f13_the_share_of_mutants_that_are_killed_is_told_and_held_to_its_bar(capsys):
    row = {"kind": "sign", "file": "a.py", "line": 1, "function": "f", "text": "x"}
    killed = [{**row, "verdict": mutation.KILLED} for _ in range(19)]
    survived = {**row, "verdict": mutation.SURVIVED}
    assert mutation.report([*killed, survived]) == 0.95 == mutation.LEAST
    assert "all: 19 of 20 mutants killed (95.0 %)" in capsys.readouterr().out
    assert mutation.report([*killed, survived, survived]) < mutation.LEAST
