"""rerun's viewer on a page of ours, in a real browser: it starts, stands still, and asks nobody."""

from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
from safetensors.numpy import save_file

from tests.shared.chromium import Chromium, browser
from tests.viz.test_viz import make_run, make_showcase
from viz.poster import poster
from viz.recording import write_recording
from viz.served import serving
from viz.viewer import web_code


@browser
def test_a_poster_stands_until_the_viewer_has_drawn_and_nobody_else_is_asked(tmp_path):
    run, showcase = make_run(tmp_path / "run", 1), make_showcase(pictures=False)
    (run / "showcase").mkdir()
    arrays = {k: np.ascontiguousarray(v) for k, v in showcase.items()}
    about = {"cell": "oracle/factored", "seed": "0", "coupling": "0.78"}
    save_file(arrays, run / "showcase" / "oracle-factored.safetensors", about)
    recording = run / "oracle-factored.rrd"
    write_recording(showcase, about, recording)
    told = poster(run, Path("oracle-factored"))
    with (
        serving([recording], web_code(), told, 0) as address,
        Chromium(tmp_path / "chromium", 400, 800, drawing=True) as tab,
    ):
        tab.tell("Network.enable")
        tab.open(address)
        tab.until("document.querySelector('#poster img')?.complete")
        assert "to go on under G = 0.78" in tab.run("return document.body.innerText")
        assert tab.run("return document.documentElement.scrollWidth") <= 400
        tab.until("document.body.dataset.drawn")
        assert tab.run("return document.getElementById('poster').hidden")
        asked = [e["params"]["request"]["url"] for e in tab.events if "request" in e["params"]]
        assert any(url.endswith(".wasm") for url in asked)
        assert {urlsplit(url).netloc for url in asked} <= {urlsplit(address).netloc, ""}
        wrong = ('"type": "error"', '"level": "error"')
        assert not [said for said in tab.errors if any(word in said for word in wrong)]
