"""Kept machine code is dropped when any kernel's file has changed, not its own file alone."""

import importlib.util

import numpy as np
import pytest

from dynamics.compiled import kernels


@pytest.fixture
def total(tmp_path):
    """A function in a file of its own, as numba wants what it keeps."""
    path = tmp_path / "total.py"
    path.write_text("def total(x):\n    s = 0.0\n    for v in x:\n        s += v\n    return s\n")
    spec = importlib.util.spec_from_file_location("total", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.total


def hits(function):
    """Kernel of a function after a call, and whether its machine code had been kept."""
    compiled = kernels.kernel(function)
    assert compiled(np.arange(4.0)) == 6.0
    return sum(compiled.stats.cache_hits.values())


def test_a_change_in_another_kernels_file_is_heeded(total, monkeypatch):
    assert hits(total) == 0
    assert hits(total) == 1
    monkeypatch.setattr(kernels, "_sources", lambda: "another file has changed")
    assert hits(total) == 0
    assert hits(total) == 1


def test_processes_do_not_write_into_one_file(total, tmp_path, monkeypatch):
    for process in (1, 2):
        monkeypatch.setattr(kernels.os, "getpid", lambda process=process: process)
        kernels.kernel(total)(np.arange(4.0, dtype=(np.float32, np.float64)[process - 1]))
    files = {path.name.split(".")[-2] for path in tmp_path.rglob("*.nbc")}
    assert files == {"1-1", "2-1"}


def test_every_file_beside_it_counts(tmp_path, monkeypatch):
    read = kernels._sources.__wrapped__
    monkeypatch.setattr(kernels, "__file__", str(tmp_path / "kernels.py"))
    found = [read()]
    for name, text in (("a.py", "1"), ("b.py", "1"), ("a.py", "2")):
        (tmp_path / name).write_text(text)
        found.append(read())
    assert len(set(found)) == 4
