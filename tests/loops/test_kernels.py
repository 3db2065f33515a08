"""Kept machine code is dropped when any kernel's file has changed, not its own file alone."""

import importlib
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from filelock import FileLock

from loops import kernels

ROOT = Path(__file__).parents[2]


@pytest.fixture
def total(tmp_path, monkeypatch):
    """A function in a file of its own, as numba wants what it keeps."""
    body = "def total(x):\n    s = 0.0\n    for v in x:\n        s += v\n    return s\n"
    (tmp_path / "total.py").write_text(body)
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("total").total
    del sys.modules["total"]


def hits(function):
    """Kernel of a function after a call, and whether its machine code had been kept."""
    compiled = kernels.kernel(function)
    assert compiled(np.arange(4.0)) == 6.0
    return sum(compiled.stats.cache_hits.values())


def test_a_change_in_another_kernels_file_is_heeded(total, monkeypatch):
    assert hits(total) == 0
    assert hits(total) == 1
    monkeypatch.setattr(kernels, "_sources", lambda folders: "another file has changed")
    assert hits(total) == 0
    assert hits(total) == 1


def test_processes_do_not_write_into_one_file(total, tmp_path, monkeypatch):
    for process in (1, 2):
        monkeypatch.setattr(kernels.os, "getpid", lambda process=process: process)
        kernels.kernel(total)(np.arange(4.0, dtype=(np.float32, np.float64)[process - 1]))
    files = {path.name.split(".")[-2] for path in tmp_path.rglob("*.nbc")}
    assert files == {"1-1", "2-1"}


OTHER = """
import sys
import numpy as np
from loops import kernels
sys.path.insert(0, sys.argv[1])
from total import total
compiled = kernels.kernel(total)
print("asks", flush=True)
compiled(np.arange(4.0))
print(sum(compiled.stats.cache_hits.values()))
"""


def test_a_process_waits_for_what_another_compiles(total, tmp_path):
    compiled = kernels.kernel(total)
    kept = compiled._cache
    kept._impl.locator.ensure_cache_path()
    with FileLock(Path(kept.cache_path) / f"{kept._impl.filename_base}.lock"):
        other = subprocess.Popen(
            [sys.executable, "-c", OTHER, str(tmp_path)],
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        )
        assert other.stdout.readline() == "asks\n"
        with pytest.raises(subprocess.TimeoutExpired):
            other.wait(4)
        type(compiled).compile(compiled, (numba.float64[::1],))  # with the lock, which is here
    assert other.communicate(timeout=60)[0] == "1\n"


def test_every_file_of_the_folders_counts(tmp_path):
    read, found = kernels._sources.__wrapped__, []
    here, there = folders = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    there.mkdir()
    for path, text in ((here / "a.py", "1"), (there / "b.py", "1"), (here / "a.py", "2")):
        path.write_text(text)
        found.append(read(frozenset(folders)))
    assert len(set(found)) == 3


def test_what_a_function_calls_in_another_folder_counts():
    from dynamics.compiled.steps import _measured, kick

    caller = type(hits)(hits.__code__, {"kick": kick, "unrelated": 3})
    folders = {folder.relative_to(ROOT).as_posix() for folder in kernels._folders(caller)}
    assert folders == {"tests/loops", "dynamics/compiled", "loops"}
    assert {folder.name for folder in kernels._folders(_measured.py_func)} == {"compiled", "loops"}
