"""A diagnosis is drawn by a process of its own, and a table needs no torch."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from vidphys.cli.drawing import Drawer, Drawing

SECONDS = 0.05 * np.arange(60)
PLACES = np.stack([SECONDS, 2 * SECONDS - 5 * SECONDS**2], -1)[:, None]
FIGURE = {"times": SECONDS, "positions": PLACES, "rolled": {"model": (SECONDS, PLACES)}}
ARRAYS = {
    "frame_times": SECONDS,
    "readout": PLACES,
    "rollout": PLACES,
    "rollout_times": SECONDS,
    "half_extent": np.asarray(3.0),
}
LIBRARIES = ("torch", "matplotlib", "rerun", "cv2", "scipy.interpolate", "pyarrow.dataset")


@pytest.fixture
def drawing(tmp_path):
    return Drawing(tmp_path, FIGURE, ARRAYS, {"cell": "diagnosis", "clip": "made"})


@pytest.fixture
def unloaded(monkeypatch):
    """As in a process that has drawn nothing yet."""
    monkeypatch.setattr("vidphys.cli.drawing.LIBRARIES", ("nothing.of.this.name",))


def test_a_table_is_diagnosed_without_what_draws_and_without_torch(tmp_path):
    table = tmp_path / "fall.csv"
    noise = 1e-3 * np.random.default_rng(0).standard_normal((60, 2))
    rows = np.column_stack([SECONDS, PLACES[:, 0] + noise])
    np.savetxt(table, rows, delimiter=",", header="t,x,y", comments="")
    code = (
        "import sys; from vidphys.cli import main; assert main(sys.argv[1:]) == 0\n"
        f"assert not [name for name in {LIBRARIES} if name in sys.modules]"
    )
    told = [sys.executable, "-c", code, "diagnose", str(table), "--out", str(tmp_path / "run")]
    subprocess.run(told, check=True)
    for name in ("figures/diagnosis.svg", "recordings/diagnosis.rrd"):
        assert (tmp_path / "run" / name).stat().st_size > 1000
    assert "<svg" in (tmp_path / "run" / "report.html").read_text()


def test_both_ways_draw_the_same(drawing, tmp_path, unloaded):
    with Drawer(aside=True) as drawer:
        assert drawer.begin(lambda: drawing)().arrays is drawing.arrays
    here = replace(drawing, run=tmp_path / "here")
    with Drawer(aside=False) as drawer:
        finish = drawer.begin(lambda: here)
        assert not here.run.exists()  # the numbers are written before
        finish()
    svg = [(x.run / "figures/diagnosis.svg").read_bytes() for x in (drawing, here)]
    assert svg[0] == svg[1] and (tmp_path / "recordings/diagnosis.rrd").exists()


def test_what_goes_wrong_is_raised_here(drawing, tmp_path, unloaded):
    (tmp_path / "figures").write_text("a file in the way")
    with Drawer(aside=True) as drawer:
        finish = drawer.begin(lambda: drawing)
        with pytest.raises(FileExistsError, match="figures"):
            finish()
    with Drawer(aside=True) as drawer:
        finish = drawer.begin(lambda: replace(drawing, figure={"nothing": 0}))
        with pytest.raises(TypeError, match="nothing"):
            finish()
    with Drawer(aside=True) as drawer:
        drawer.process.kill()
        with pytest.raises(RuntimeError, match="the process that draws ended with -9"):
            drawer.begin(lambda: drawing)()


def test_it_ends_with_nothing_drawn(unloaded, tmp_path):
    with Drawer(aside=True) as drawer:
        process = drawer.process
        assert process.poll() is None
    assert process.returncode is not None and not list(tmp_path.iterdir())


def test_where_the_libraries_are_loaded_no_process_is_started(monkeypatch):
    monkeypatch.setattr("vidphys.cli.drawing.LIBRARIES", ("sys",))
    assert Drawer(aside=True).process is None
