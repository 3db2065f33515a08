"""The report in a real browser: nothing goes wrong or lies beside the screen, sliders answer."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch

from dynamics import HEADS, build
from tests.viz.test_viz import make_run, make_showcase
from vidphys.cli import playing
from viz.report import write_report

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
CSS = Path(playing.__file__).parents[2] / "viz" / "templates" / "page.css"
FRAME = """<body><iframe id="page" src="{page}" style="width:{width}px;height:{height}px"></iframe>
<script>
addEventListener("load", () => setTimeout(() => {{
  const page = document.getElementById("page").contentDocument;
  const answer = (() => {{ {ask} }})();
  document.body.textContent = "ANS" + "WER" + JSON.stringify(answer) + "END";
}}, 300));
</script>"""


def look(page: Path, ask: str, width: int = 1400, height: int = 900):
    """What a script answers that can see the page, and the errors of the browser's console."""
    frame = page.with_name("frame.html")
    url = page.resolve().as_uri()
    frame.write_text(FRAME.format(page=url, width=width, height=height, ask=ask))
    options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files"]
    options += ["--enable-logging=stderr", "--virtual-time-budget=15000", "--dump-dom"]
    done = subprocess.run(
        [CHROMIUM, *options, frame.resolve().as_uri()], capture_output=True, text=True, timeout=100
    )
    found = re.search(r"ANSWER(.*?)END", done.stdout, re.S)
    assert found, done.stdout[:500] + done.stderr[-500:]
    errors = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return json.loads(found[1]), errors


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """A ladder's report with everything that moves."""
    from safetensors.numpy import save_file

    run = make_run(tmp_path_factory.mktemp("run") / "run", 3)
    (run / "showcase").mkdir()
    arrays = {k: np.ascontiguousarray(v) for k, v in make_showcase(pictures=False).items()}
    for head in ("factored", "unstructured"):
        about = {"cell": f"oracle/{head}", "seed": "0", "coupling": "1.0"}
        save_file(arrays, run / "showcase" / f"oracle-{head}.safetensors", about)
    torch.manual_seed(0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(playing, "STARTS", 8)
        law = playing.law_to_play(build(HEADS["factored"], bodies=3, dt=0.002))
    (run / "play.json").write_text(json.dumps(law))
    return write_report(run)


@browser
def test_nothing_goes_wrong_and_all_that_moves_is_there(page):
    ask = """const text = (id) => page.getElementById(id).textContent;
      const spent = Number(page.getElementById("law-canvas").dataset.ms);
      return [page.querySelectorAll("canvas").length, text("play"), spent, text("law-said")];"""
    (canvases, play, spent, said), errors = look(page, ask)
    assert errors == []
    assert canvases == 3 and play in ("Pause", "Play") and "off by at most" in said
    assert spent > 0


@browser
@pytest.mark.parametrize(("width", "height"), [(400, 800), (1400, 900)])
def test_the_first_screen_holds_the_sentences_and_the_figure(page, width, height):
    ask = """const box = page.querySelector("svg.headline").getBoundingClientRect();
      const sentences = page.querySelectorAll("ol.three li").length;
      return [page.documentElement.scrollWidth, box.bottom, sentences];"""
    (wide, bottom, sentences), errors = look(page, ask, width, height)
    assert errors == [] and sentences == 3
    assert wide <= width and bottom <= height


@browser
def test_a_slider_moves_the_law_and_a_reset_brings_it_back(page):
    ask = """const canvas = page.getElementById("law-canvas"), ink = () => canvas.toDataURL();
      const slider = page.querySelector("#law input"), before = ink();
      slider.value = "1"; slider.dispatchEvent(new Event("input"));
      const after = ink();
      page.getElementById("law-reset").click();
      return [before === after, before === ink(), page.querySelector("#law output").textContent];"""
    (same, back, told), errors = look(page, ask)
    assert errors == [] and not same and back and told == "−1.00"


@browser
def test_the_table_sorts_and_filters_and_a_mark_tells_its_cell(page):
    ask = """const rows = () => [...page.querySelectorAll("#cells tbody tr")];
      page.querySelectorAll("#cells thead button")[2].click();
      const values = rows().map((row) => row.cells[2].dataset.value).filter((x) => x).map(Number);
      const filter = page.getElementById("filter");
      filter.value = "renderer factored"; filter.dispatchEvent(new Event("input"));
      const shown = rows().filter((row) => !row.hidden).map((row) => row.cells[0].innerText);
      page.querySelector(".dot").dispatchEvent(new Event("click"));
      return [values, shown, page.getElementById("picked").textContent];"""
    (values, shown, told), errors = look(page, ask)
    assert errors == [] and values == sorted(values) and len(values) == 8
    assert len(shown) == 2 and all("renderer" in name for name in shown)
    assert told.startswith("oracle, ")


def light(colour):
    """Relative luminance, as the web's guidelines define it."""
    whole = colour if len(colour) == 7 else "#" + "".join(2 * c for c in colour[1:])
    parts = np.array([int(whole[k : k + 2], 16) / 255 for k in (1, 3, 5)])
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(a, b):
    low, high = sorted((light(a), light(b)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("dark", [False, True])
def test_words_and_marks_stand_out_in_light_and_dark(dark):
    css = CSS.read_text()
    part = css[css.index("prefers-color-scheme") :] if dark else css
    tones = dict(re.findall(r"--([\w-]+):(#\w+)", part[: part.index("}")]))
    for text in ("ink", "dim", "good", "bad", "accent"):
        for ground in ("page", "soft"):
            assert contrast(tones[text], tones[ground]) >= 4.5, (text, ground)
    assert contrast(tones["good"], tones["good-soft"]) >= 4.5
    assert contrast(tones["bad"], tones["bad-soft"]) >= 4.5
    script = (CSS.parent / "page.js").read_text()
    hues = re.findall(r'"(#\w{6})"', script[script.index("const HUES") :].partition("]")[0])
    marks = [tones["head"], tones["twin"], tones["ghost"], *hues]
    assert len(hues) >= 5
    assert min(contrast(mark, tones["page"]) for mark in marks) >= 3
