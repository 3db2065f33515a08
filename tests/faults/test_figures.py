"""F1 to F14 and Z1 to Z17 are each held by a test that says its number: 31 of 31."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.mutation import __main__ as mutation

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(("letter", "last"), [("f", 14), ("z", 17)])
def test_every_figure_is_in_the_name_of_a_test(letter, last):
    texts = [p.read_text() for room in ("faults", "hostile") for p in (ROOT / room).glob("*.py")]
    names = re.findall(r"def (test_\w+)", "\n".join(texts))
    held = {int(number) for name in names for number in re.findall(rf"_{letter}(\d+)(?=_)", name)}
    assert held == set(range(1, last + 1))


def test_f13_the_share_of_mutants_that_are_killed_is_told_and_held_to_its_bar(capsys):
    row = {"kind": "sign", "file": "a.py", "line": 1, "function": "f", "text": "x"}
    killed = [{**row, "verdict": mutation.KILLED} for _ in range(19)]
    survived = {**row, "verdict": mutation.SURVIVED}
    assert mutation.report([*killed, survived]) == 0.95 == mutation.LEAST
    assert "all: 19 of 20 mutants killed (95.0 %)" in capsys.readouterr().out
    assert mutation.report([*killed, survived, survived]) < mutation.LEAST
