"""``vidphys play`` in a real browser: a change is rolled and drawn, on a desk and on a phone."""

import json
import os
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest

from tests.shared.chromium import Chromium, browser
from tests.viz.test_viz import read_back
from vidphys.cli import main
from vidphys.cli.play import KINDS, Player
from vidphys.play import pieces, source_of, stage, surveys
from viz.played import play_page


@pytest.fixture(scope="module")
def address():
    """The page of a scene, answered in a thread of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stage, "AT_ONCE", 9)
        patch.setattr(surveys, "BATCH", 20)
        patch.setattr(pieces, "WAIT", 0.1)  # on a busy machine checks of short pieces take longer
        source = source_of("springs", episodes=40)
        told = {"title": "Play", "folder": "springs", "cells": source.names}
        with play_page(told, 0, KINDS) as (found, desk):
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
        tab.until("document.getElementById('counted').textContent === '40 of 40 episodes'")
        rows = """const of = (name) => document.getElementById(name);
          const rows = () => [...document.querySelectorAll('#episodes tr[data-episode]')];
          const numbers = (k) => rows().map((row) => Number(row.cells[k].dataset.value));
          document.querySelectorAll('#episodes thead button')[3].click(); rows()[0].click();
          const worst = [rows()[0].dataset.episode, of('episode').value], ends = numbers(3);
          of('which').value = 'closest < 0.8 ok'; of('which').dispatchEvent(new Event('input'));
          const near = numbers(4);
          of('which').value = ''; of('which').dispatchEvent(new Event('input'));
          const all = numbers(4);
          document.querySelector('[data-pick=typical]').click();
          return [worst, ends, near, all, of('episode').value === rows()[20].dataset.episode];"""
        worst, ends, near, every, typical = tab.run(rows)
        assert worst[0] == worst[1] and ends == sorted(ends, reverse=True)  # one click and its row
        assert sorted(near) == sorted(x for x in every if x < 0.8) and 0 < len(near) < 40
        assert typical and len(ends) == 40
        tab.until("document.getElementById('said').textContent.startsWith('9 × 2,000')")
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


def test_what_is_played_is_saved_as_a_recording_that_view_opens(tmp_path):
    player = Player(source_of("springs", episodes=2))
    asked = {"cell": "springs", "episode": 1, "coupling": -1.0, "steps": 400}
    ((about, recording),) = player.record(json.dumps(asked).encode())
    path = tmp_path / about["name"]
    path.write_bytes(recording)
    assert main(["view", str(path), "--save", str(tmp_path / "copy")]) == 0
    found = read_back(tmp_path / "copy" / "springs-1.rrd")
    rolled = player.rolled(json.dumps(asked).encode())
    parts = [part for part in rolled if not isinstance(part, float)]
    numbers = np.concatenate([places for a, places in parts if a["role"] == "model"], 1)
    seen = np.concatenate([np.stack(list(x)) for x in found["/world/model"]["Points2D:positions"]])
    assert np.allclose(seen, numbers[1, ::2].reshape(-1, 2), atol=1e-5)
    assert "/world/truth" in found and "/energy/model" in found
    assert "G = −1" in str(found["/about"]) and len(recording) < 300_000


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
