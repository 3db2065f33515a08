"""A number is stale when what could have made it has changed, and no other time."""

import shutil
from functools import partial

import pytest

from vidphys.experiments.catalogue import TABLES
from vidphys.runs.code import OWN, SOURCE, code_hash, modules_of
from vidphys.runs.folder import RunFolder
from vidphys.runs.records import Origin, Recorder
from vidphys.scenes import gravity

SKIPPED = shutil.ignore_patterns("__pycache__", "data", "*.pyc")


def makers(cell: str) -> tuple[str, ...]:
    table = TABLES["ladder"]
    return tuple(sorted({*modules_of(table.cells[cell]), table.module}))


@pytest.fixture(scope="module")
def copied(tmp_path_factory):
    tree = tmp_path_factory.mktemp("tree")
    for name in (*OWN, "viz"):
        shutil.copytree(SOURCE / name, tree / name, ignore=SKIPPED)
    return tree


CHANGES = {
    "dynamics/integrators.py": {"oracle", "renderer", "anonymous-slots", "i3d"},
    "loops/threads.py": {"oracle", "renderer", "anonymous-slots", "i3d"},
    "vidphys/experiments/core/scoring.py": {"oracle", "renderer", "anonymous-slots", "i3d"},
    "vidphys/experiments/ladder.py": {"oracle", "renderer", "anonymous-slots", "i3d"},
    "vidphys/perception/synthesis.py": {"renderer"},
    "vidphys/perception/slots.py": {"anonymous-slots"},
    "vidphys/training/refinement.py": {"i3d"},
    "vidphys/perception/catalogue.py": set(),
    "vidphys/experiments/core/bars.py": set(),
    "vidphys/cli/ladder.py": set(),
    "vidphys/diagnose/diagnosis.py": set(),
    "viz/report.py": set(),
    "vidphys/__init__.py": set(),
}


@pytest.mark.parametrize("changed", CHANGES)
def test_a_change_makes_those_rungs_stale_that_it_could_have_made(copied, tmp_path, changed):
    file = copied / changed
    text = file.read_text(encoding="utf-8")
    rungs = {rung: makers(f"{rung}/factored") for rung in CHANGES["dynamics/integrators.py"]}
    before = {rung: _hash(names, copied) for rung, names in rungs.items()}
    try:
        file.write_text(text + "\n# another line\n", encoding="utf-8")
        stale = {rung for rung, names in rungs.items() if _hash(names, copied) != before[rung]}
    finally:
        file.write_text(text, encoding="utf-8")
    assert stale == CHANGES[changed]


def _hash(names, source):
    return code_hash.__wrapped__(names, source)  # what is read is what lies there now


def test_a_module_that_is_gone_is_a_change_and_types_alone_are_none(tmp_path):
    (tmp_path / "dynamics").mkdir()
    (tmp_path / "dynamics" / "a.py").write_text(
        "if TYPE_CHECKING:\n    from dynamics.b import B\nelse:\n    import dynamics.c\n"
        "def f():\n    from dynamics import d\n"
        "HOMES = {'E': 'dynamics.e'}\n"  # handed on lazily
    )
    for name in "bcde":
        (tmp_path / "dynamics" / f"{name}.py").write_text("")
    now = _hash(("dynamics.a",), tmp_path)
    (tmp_path / "dynamics" / "b.py").write_text("1")
    assert _hash(("dynamics.a",), tmp_path) == now
    found = {now}
    for name in "cde":
        (tmp_path / "dynamics" / f"{name}.py").write_text("1")
        found.add(_hash(("dynamics.a",), tmp_path))
    (tmp_path / "dynamics" / "a.py").unlink()
    assert len({*found, _hash(("dynamics.a",), tmp_path)}) == 5


def test_a_parts_modules_are_those_of_all_that_it_holds():
    def scene():
        return partial(gravity, "gaussian")

    held = [{"a": (scene(), RunFolder.join, 3)}, RunFolder]
    assert modules_of(held) == ("vidphys.runs.folder", "vidphys.scenes.gravity")
    assert modules_of("text", len, 3.0) == ()


def test_each_part_of_a_run_is_held_to_its_own_code(tmp_path, monkeypatch):
    run = RunFolder.open(tmp_path / "r", {"cells": ["a", "b"], "seeds": [0]})
    for cell, names in {"a": ("vidphys.metrics",), "b": ("vidphys.seeding",), "c": ()}.items():
        origin = Origin("e", cell, "s", "a", "none", "none", "none", "b", 0, "cpu", "f32")
        recorder = Recorder(origin)
        recorder.add_value("m", 1.0)
        run.finish(cell, *recorder.tables(), names)
    assert {row["stale"] for row in run.join().to_pylist()} == {False}
    other = {("vidphys.metrics",): "other"}
    monkeypatch.setattr("vidphys.runs.origin.code_hash", lambda m: other.get(m) or code_hash(m))
    assert [row["stale"] for row in run.join().to_pylist()] == [True, False, False]
