"""Every report in a real browser, on a screen and a phone, light and dark: all can be read."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.shared.chromium import Chromium, browser
from tests.viz.test_measured import cell
from tests.viz.test_results_report import run as tables_run
from tests.viz.test_viz import make_run
from viz.comparison import write_comparison
from viz.figures import SPARE, STYLES
from viz.report import write_report
from viz.results import write_results
from viz.stress import write_stress_report
from viz.told import write_told

LOOK = (Path(__file__).parents[1] / "shared" / "seen.js").read_text()
tables = tables_run


def rolled(folder):
    folder.mkdir()
    settings = {"experiment": "rollout", "beyond": 1.0, "coupling": -1.0, "law": [], "stop": None}
    (folder / "run.json").write_text(json.dumps({"settings": settings}))
    times, path = np.arange(9) * 0.1, np.random.default_rng(0).standard_normal((9, 2, 2))
    arrays = {"times": times, "track": path, "rollout_times": 0.8 + times, "rollout": path}
    np.savez(folder / "rollout.npz", **arrays, changed=-path)
    return write_told(folder)


def stressed(folder):
    folder.mkdir()
    verdicts = ("sound", "warned", "refused", "silently wrong")
    cells = [cell(x, verdict) for x in (0.1, 0.2) for verdict in verdicts]
    counts = dict.fromkeys(verdicts, 2)
    found = {"cells": cells, "counts": counts, "figures": [], "seconds": 1.0}
    (folder / "verdicts.json").write_text(json.dumps(found))
    about = {"settings": {"preset": "quick"}, "code_version": "abc"}
    (folder / "run.json").write_text(json.dumps(about))
    return write_stress_report(folder)


@pytest.fixture
def pages(tmp_path, tables):
    runs = [make_run(tmp_path / name, 3) for name in ("before", "after")]
    reports = [write_report(runs[0]), write_comparison(runs, tmp_path / "compared")]
    return [*reports, write_results(tables), rolled(tmp_path / "r"), stressed(tmp_path / "s")]


@browser
def test_all_that_a_page_says_and_draws_can_be_read_on_any_screen(pages, tmp_path):
    found = {}
    with Chromium(tmp_path / "chromium") as tab:
        for scheme in ("light", "dark"):
            wish = {"name": "prefers-color-scheme", "value": scheme}
            tab.tell("Emulation.setEmulatedMedia", features=[wish])
            for page in pages:
                for width, height in ((1400, 900), (400, 800)):
                    tab.size(width, height)
                    tab.open(page.as_uri())
                    tab.until("document.readyState === 'complete'")
                    seen = tab.run(LOOK)
                    wide = seen["width"] > width
                    if wide or seen["words"] or seen["marks"]:
                        found[page.parent.name, scheme, width] = seen
        assert found == {} and tab.errors == []


@pytest.mark.parametrize("colour", [style[0] for style in (*STYLES.values(), *SPARE)])
def test_a_model_has_a_colour_that_stands_out_on_white_and_on_a_dark_page(colour):
    from tests.viz.test_browser import contrast

    assert min(contrast(colour, "#ffffff"), contrast(colour, "#15191d")) >= 3
