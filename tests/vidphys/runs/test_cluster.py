"""A cluster does with tasks what the pool of processes does; what is lost there is done again.

Skipped where Ray is not installed or does not start: on a machine that has much to do, its own
processes wait for each other no longer than a few seconds.
"""

import os
import signal
import subprocess
import sys
import time
import warnings
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.shared.errands import errand
from tests.shared.nodes import cluster, node
from vidphys.errors import InputError
from vidphys.runs.cluster import Cluster
from vidphys.runs.engine import engine_of
from vidphys.runs.needs import Needs
from vidphys.runs.tasks import WorkerLost, WorkerWarning

LONG = pytest.mark.skipif(
    "VIDPHYS_FAULTS" not in os.environ, reason="make faults runs it, half a minute"
)
KINDS = {"a": "write", "b": "once", "c": "fail", "d": "write", "e": "die"}


def run(engine, folder, kinds):
    folder.mkdir(exist_ok=True)
    shown, finished = [], []
    tasks = [(folder, name, kind) for name, kind in kinds.items()]
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        failures = engine(errand, tasks, shown.append, finished.append)
    lost = [str(w.message) for w in said if issubclass(w.category, WorkerWarning)]
    done = {path.stem for path in folder.glob("*.done")}
    return {n: error for n, error in failures}, sorted(finished), shown, lost, done


@pytest.fixture(scope="module")
def nodes():
    """A cluster with a node of one core, on this machine."""
    pytest.importorskip("ray")
    with ExitStack() as stack:
        try:
            made = stack.enter_context(cluster())
        except Exception as error:
            pytest.skip(f"no Ray cluster starts here: {error}")
        yield made


def check(found):
    failures, finished, shown, lost, done = found
    assert done == {"a", "b", "d"} and finished == [0, 1, 3]
    assert isinstance(failures[2], ValueError) and "c cannot be done" in str(failures[2])
    assert isinstance(failures[4], WorkerLost) and failures.keys() == {2, 4}
    assert len(lost) == 3  # once of b, and of e before it was given up
    assert ("a", 1, 1) in shown


@pytest.mark.timeout(400)
def test_a_cluster_does_the_same(tmp_path, nodes):
    check(run(engine_of("ray", 2, nodes.address), tmp_path / "run", KINDS))


@pytest.fixture
def jobs(tmp_path, monkeypatch):
    """Jobs that are processes of this machine, be there Slurm or not."""
    submitit = pytest.importorskip("submitit")
    monkeypatch.setattr(submitit.AutoExecutor, "which", staticmethod(lambda: "local"))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[3]))  # of the errands
    yield engine_of("submitit", 2, jobs=tmp_path / "jobs")
    assert [path.name for path in tmp_path.iterdir()] == ["run"]  # nothing of their own is left


def test_jobs_do_what_they_are_given_and_say_what_failed(tmp_path, jobs):
    failures, finished, shown, lost, done = run(jobs, tmp_path / "run", {"a": "write", "c": "fail"})
    assert (finished, done, lost) == ([0], {"a"}, []) and ("a", 1, 1) in shown
    assert failures.keys() == {1} and "c cannot be done" in str(failures[1])


@LONG
@pytest.mark.timeout(400)
def test_jobs_that_are_lost_are_done_again(tmp_path, jobs):
    check(run(jobs, tmp_path / "run", KINDS))


@LONG
@pytest.mark.timeout(400)
def test_a_lost_node_loses_its_running_tasks_only(tmp_path, nodes):
    other = nodes.add_node(**node(2))
    folder, kinds = tmp_path / "run", {name: "slow" for name in "abcdefgh"}

    def lose(done):
        if len(done) == 2:
            nodes.remove_node(other, allow_graceful=False)

    finished = []

    def after(number):
        finished.append(number)
        lose(finished)

    folder.mkdir()
    tasks = [(folder, name, kind) for name, kind in kinds.items()]
    engine = engine_of("ray", 2, nodes.address)
    with pytest.warns(WorkerWarning, match="tried again"):
        assert engine(errand, tasks, lambda _: None, after) == []
    assert sorted(finished) == list(range(8))
    assert {path.stem for path in folder.glob("*.done")} == set(kinds)


DRIVER = """
import sys
from pathlib import Path
from tests.shared.errands import errand
from vidphys.runs.engine import engine_of
folder = Path(sys.argv[1])
tasks = [(folder, name, "slow") for name in "abcd" if not (folder / f"{name}.done").exists()]
print(len(tasks), engine_of("ray", 1, sys.argv[2])(errand, tasks, print, print))
"""


@LONG
@pytest.mark.timeout(400)
def test_a_driver_that_was_killed_goes_on_where_it_was(tmp_path, nodes):
    folder = tmp_path / "run"
    folder.mkdir()
    command = [sys.executable, "-c", DRIVER, str(folder), nodes.address]
    first = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    until = time.monotonic() + 300
    while not list(folder.glob("*.done")) and time.monotonic() < until:
        time.sleep(0.1)
    os.kill(first.pid, signal.SIGKILL)
    first.wait()
    before = {path: path.stat().st_mtime_ns for path in folder.glob("*.done")}
    told = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True).stdout
    assert told.splitlines()[-1].endswith("[]") and before
    assert {path.stem for path in folder.glob("*.done")} == set("abcd")
    assert all(path.stat().st_mtime_ns == when for path, when in before.items())


def test_what_an_engine_refuses(monkeypatch):
    with pytest.raises(InputError, match="`address`"):
        engine_of("local", 1, "auto")
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match="pip install"):
        Cluster(1, None, ())


def test_no_task_asks_for_more_than_the_largest_node_has(monkeypatch):
    nodes = [
        {"Alive": True, "Resources": {"CPU": 2.0, "memory": 2.0e9}},
        {"Alive": True, "Resources": {"CPU": 4.0, "memory": 1.0e9}},
        {"Alive": False, "Resources": {"CPU": 64.0, "memory": 9.0e9}},
    ]
    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(nodes=lambda: nodes))
    needs = [Needs(cores=8, memory=10**9), Needs(memory=10**10, gpu=0.25)]
    assert Cluster(2, None, needs)._asked(3) == [
        {"num_cpus": 4.0, "num_gpus": 0.0, "memory": 10**9},
        {"num_cpus": 1.0, "num_gpus": 0.25, "memory": 2 * 10**9},
        {"num_cpus": 1.0, "num_gpus": 0.0},
    ]


def test_a_cluster_of_ones_own_is_new_and_leaves_signals_as_they_were(monkeypatch):
    asked = []

    def init(**how):
        asked.append((how, os.environ["RAY_USAGE_STATS_ENABLED"]))
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # Ray's own handler ends the driver

    left = SimpleNamespace(init=init, shutdown=lambda: asked.append("left"))
    monkeypatch.setitem(sys.modules, "ray", left)
    monkeypatch.setattr(os, "environ", {})
    before = signal.getsignal(signal.SIGTERM)
    engine = engine_of("ray", 3)
    engine._join()
    how, told = asked[0]
    # "local": of a cluster that is gone there may be a trace, which Ray would follow else
    assert how["address"] == "local" and how["num_cpus"] == 3 and not how["include_dashboard"]
    assert told == "0" and signal.getsignal(signal.SIGTERM) is before
    engine_of("ray", 3, "10.0.0.1:6379")._join()
    assert asked[1][0]["address"] == "10.0.0.1:6379" and "num_cpus" not in asked[1][0]
