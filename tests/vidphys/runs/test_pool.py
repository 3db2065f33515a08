"""Workers end when they are told to, and when nobody is left to tell them."""

import os
import subprocess
import sys
import time
from pathlib import Path

import torch

from vidphys.runs.engine import engine_of
from vidphys.runs.needs import Needs
from vidphys.training.loop import _finish_step_on_signal

PARENT = """
import sys
from pathlib import Path
from tests.vidphys.runs.test_pool import stubborn
from vidphys.runs.pool import run_all
if __name__ == "__main__":
    tasks = [(Path(sys.argv[1]), name) for name in "abc"]
    run_all(stubborn, tasks, 1, print, print)
"""


def stubborn(folder: Path, name: str, _report) -> None:
    """Work that ends a signalled step in its own time, as training does."""
    with _finish_step_on_signal() as interrupted:
        (folder / name).write_text(str(os.getpid()))
        interrupted.wait(60)
        (folder / f"{name}-kept").touch()
        raise KeyboardInterrupt


def tell_card(folder: Path, name: str, _report) -> None:
    (folder / name).write_text(os.environ.get("CUDA_VISIBLE_DEVICES", "all"))
    (folder / f"{name}-threads").write_text(str(torch.get_num_threads()))
    (folder / f"{name}-begun").touch()
    _until(lambda: len(list(folder.glob("*-begun"))) == 3)


def test_workers_get_the_cards_in_turn_and_have_one_thread(tmp_path: Path, monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3, 5")
    tasks, share = [(tmp_path, name) for name in "abc"], [Needs(gpu=0.5)] * 3
    assert engine_of("local", 3, None, share)(tell_card, tasks, print, lambda _: None) == []
    assert sorted((tmp_path / name).read_text() for name in "abc") == ["3", "3", "5"]
    assert {(tmp_path / f"{name}-threads").read_text() for name in "abc"} == {"1"}
    assert os.environ["CUDA_VISIBLE_DEVICES"] == "3, 5"


def test_workers_keep_their_work_and_end_when_the_run_is_killed(tmp_path: Path):
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    home = Path(__file__).parents[3]
    run = subprocess.Popen(
        [sys.executable, str(script), str(tmp_path)],
        env={**os.environ, "PYTHONPATH": str(home)},
        stderr=subprocess.DEVNULL,
    )
    _until((tmp_path / "a").exists)
    worker = int((tmp_path / "a").read_text() or _again(tmp_path / "a"))
    run.kill()
    _until(lambda: not Path(f"/proc/{worker}").exists())
    assert (tmp_path / "a-kept").exists()
    assert not (tmp_path / "b").exists()  # no worker went on to the next task


def _again(path: Path) -> str:
    time.sleep(0.2)
    return path.read_text()


def _until(true, seconds: float = 60) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.05)
