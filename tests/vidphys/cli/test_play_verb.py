"""``vidphys play`` in a real browser: a change is rolled and drawn, on a desk and on a phone."""

import os
import signal
import subprocess
import sys
import threading

import pytest

from tests.shared.chromium import Chromium, browser
from vidphys.cli import main
from vidphys.cli.play import OPEN, ROLL, Player
from vidphys.play import source_of, sources
from viz.played import play_page


@pytest.fixture(scope="module")
def address():
    """The page of a scene, answered in a thread of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sources, "EPISODES", 9)
        source = source_of("springs")
        told = {"title": "Play", "folder": "springs", "cells": source.names}
        with play_page(told, 0, (OPEN, ROLL)) as (found, desk):
            work = threading.Thread(target=desk.work, args=(Player(source).answers,), daemon=True)
            work.start()
            yield found


@browser
def test_a_change_is_rolled_and_drawn_and_nothing_goes_wrong(address, tmp_path):
    with Chromium(tmp_path / "chrome") as tab:
        tab.open(address)
        tab.until("document.getElementById('stage')?.dataset.told")
        before = tab.run("return document.getElementById('stage').toDataURL()")
        tab.run("""const s = document.querySelector('#law input'); s.value = 0.1;
          s.dispatchEvent(new Event('input'));""")
        tab.until("document.getElementById('stage').dataset.drawn > 1")
        assert tab.run("return document.getElementById('stage').toDataURL()") != before
        assert float(tab.run("return document.getElementById('stage').dataset.ms")) > 0
        said = tab.run("return document.getElementById('said').textContent")
        assert said.startswith("9 × 2,000 steps")
        tab.until("document.querySelectorAll('#cells tbody tr').length === 9")
        rows = """const rows = () => [...document.querySelectorAll('#cells tbody tr')];
          document.querySelectorAll('#cells thead button')[3].click();
          document.querySelectorAll('#cells thead button')[3].click(); rows()[0].click();
          return [rows()[0].dataset.episode, document.getElementById('episode').value,
            rows().map((row) => Number(row.cells[3].dataset.value))];"""
        worst, chosen, ends = tab.run(rows)
        assert worst == chosen and ends == sorted(ends, reverse=True)  # two clicks and its row
        assert tab.errors == []
        pictures = os.environ.get("VIDPHYS_PICTURES")
        for width, height in ((1400, 900), (400, 800)):
            tab.size(width, height)
            assert tab.run("return document.documentElement.scrollWidth") <= width
            if pictures:
                tab.picture(tmp_path / f"play-{width}.png")


@browser
def test_a_body_is_dragged(address, tmp_path):
    drag = """const c = document.getElementById('stage'), box = c.getBoundingClientRect();
      const at = (type, x, y) => c.dispatchEvent(new PointerEvent(type,
        { pointerId: 1, clientX: box.left + x, clientY: box.top + y, bubbles: true }));
      c.setPointerCapture = () => {};
      const ink = c.toDataURL(), drawn = Number(c.dataset.drawn);
      for (let x = 20; x < box.width; x += 12) for (let y = 20; y < box.height; y += 12) {
        at('pointerdown', x, y); at('pointermove', x + 30, y + 30); at('pointerup', x, y);
      }
      for (let k = 0; k < 500 && Number(c.dataset.drawn) === drawn; k++)
        await new Promise((done) => setTimeout(done, 20));
      return ink !== c.toDataURL();"""
    with Chromium(tmp_path / "chrome") as tab:
        tab.open(address)
        tab.until("document.getElementById('stage')?.dataset.told")
        assert tab.run(drag) and tab.errors == []


def test_it_says_where_it_is_and_ends_when_it_is_told():
    command = [sys.executable, "-m", "vidphys", "play", "springs", "--no-open"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as run:
        assert run.stdout.readline().startswith("open      http://127.0.0.1:")
        run.send_signal(signal.SIGINT)
        _, said = run.communicate(timeout=60)
    assert run.returncode == 130 and "Traceback" not in said


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (["nowhere"], "no such folder"),
        (["springs", "--port", "99999"], "--port 99999"),
        (["springs", "clip.avi"], "only a training, a fit or a diagnosis"),
    ],
)
def test_what_cannot_be_played_is_one_line(wrong, said, capsys):
    assert main(["play", *wrong, "--no-open"]) == 2
    assert said in capsys.readouterr().err
