"""The mutation test itself: which places it finds, and what counts as noticed."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import pytest
import torch

sys.path.insert(0, str(Path(__file__).parents[2]))
probe = import_module("tests.mutation.probe")
rewrite = import_module("tests.mutation.rewrite")
equivalent = import_module("tests.mutation.equivalent")

LAW = """
def force(q, k, g):
    pull = -k * q[..., -1]
    return pull + g

def helper(n):
    return n - 1
"""
CHECKS = """
def test(bound):
    assert error < 1e-9
    assert error < bound
    assert 0.1 < size < 0.2
    assert len(found) < 300
    torch.testing.assert_close(a, b)
    assert x == pytest.approx(1.0)
"""


@pytest.fixture
def untouched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probe, "active", None)
    monkeypatch.setattr(probe, "room", {})


def test_signs_of_terms_are_found_and_turned(untouched: None, monkeypatch) -> None:
    places: list = []
    source = rewrite.rewritten(LAW, rewrite.Signs, "law.py", places)
    assert [place.text for place in places] == ["k", "pull + g", "g"]
    monkeypatch.setitem(sys.modules, rewrite.PROBE, probe)
    law: dict = {}
    exec(source, law)
    found = []
    for active in (None, 0, 1, 2):
        monkeypatch.setattr(probe, "active", active)
        found.append(law["force"](torch.tensor([2.0]), 3.0, 1.0).item())
    assert found == [-5.0, 7.0, 5.0, -7.0]


@pytest.mark.parametrize(
    "statement",
    [
        "w[0] = zero if far else one",
        "return s * torch.randn_like(p)",
        "raise E(f'{a - b}')",
        "return []",
    ],
)
def test_what_has_no_sign_is_no_mutant(statement: str) -> None:
    places: list = []
    rewrite.rewritten(f"def force():\n    {statement}\n", rewrite.Signs, "law.py", places)
    assert not places


def test_tolerances_are_found_and_others_are_not() -> None:
    places: list = []
    rewrite.rewritten(CHECKS, rewrite.Tolerances, "test.py", places)
    assert [place.line for place in places] == [3, 4, 7, 8]


@pytest.mark.parametrize(("error", "room"), [(0.5e-6, 0), (0.5e-7, 1), (0.5e-9, 3), (0.0, 16)])
def test_the_room_of_a_tolerance_is_in_powers_of_ten(untouched, error: float, room: int) -> None:
    probe.below(0, error, lambda scale: scale * 1e-6, False)
    one = torch.ones(1, dtype=torch.float64)
    probe.close(1, torch.testing.assert_close, one + error, one, rtol=0, atol=1e-6)
    assert probe.room == {0: room, 1: room if error else 16}
    assert 1.0 + error == probe.approx(2, 1.0, abs=1e-6)
    assert probe.room[2] == room


def test_controls_and_tolerances_of_rounding_are_no_mutants(untouched: None) -> None:
    assert not probe.below(0, 1.0, lambda scale: scale * 1e-6, False)  # does not hold
    assert probe.below(1, 0.0, lambda scale: scale * 1e-15, False)
    probe.close(2, torch.testing.assert_close, torch.ones(1), torch.ones(1), rtol=1e-6, atol=1e-6)
    assert probe.room == {}


def test_a_sign_that_is_said_to_be_equivalent_must_be_there() -> None:
    key = ("dynamics/couplings.py", "_charge", "params.charge")
    place = rewrite.Place("sign", *key[:1], 28, *key[1:])
    assert equivalent.reason_of(*key) and not equivalent.reason_of(*key[:2], "params.coupling")
    assert equivalent.stale([place], ["dynamics/couplings.py"]) == [
        ("dynamics/couplings.py", "PairLaw.strength", "amount")
    ]
