"""Seeds of confirmation are reported, development stands greyed, and stale numbers say so."""

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.viz.test_viz import make_run
from viz.report import write_report
from viz.roles import by_role, first, named, roles
from viz.summary import Records


def row(seed, role, value=0.25):
    cell = {"grounding": "oracle", "readout": "none", "head": "factored", "status": "ok"}
    about = {"metric": "inversion_nmse", "coupling": -1.0, "horizon": 150}
    return {**cell, **about, "seed": seed, "value": value, "role": role}


def test_what_is_shown_is_never_a_mean_over_both():
    mixed = [row(0, "development", 9.0), row(100, "confirmation"), row(101, "confirmation")]
    shown, aside = by_role(Records(mixed))
    assert [r["seed"] for r in shown.rows] == [100, 101] and [r["seed"] for r in aside.rows] == [0]
    assert named(Records(mixed)) == "100, 101 (confirmation); 0 (development)"
    assert roles(mixed) == ["confirmation", "development"]
    for alone in ([row(0, "development")], [row(0, None)], [row(100, "confirmation")]):
        shown, aside = by_role(Records(alone))
        assert shown.rows == alone and aside is None
    assert named(Records([row(0, None)])) == "0"
    assert first([]) == []


@pytest.fixture
def run(tmp_path):
    path = make_run(tmp_path / "run")
    table = pq.read_table(path / "records.parquet")
    seeds = table["seed"].to_pylist()
    kept = ["confirmation" if seed == 2 else "development" for seed in seeds]
    table = table.append_column("role", pa.array(kept))
    table = table.append_column("stale", pa.array([seed == 2 for seed in seeds]))
    pq.write_table(table, path / "records.parquet")
    return path


def test_the_ladder_is_of_confirmation_and_development_comes_last(run):
    html = write_report(run).read_text()
    assert "2 (confirmation); 0, 1 (development)" in html
    ladder = html.index('<section id="ladder">')
    last = html.index('<section id="development">')
    assert ladder < last and 'class="development"' in html[last:]
    assert "Seeds 0, 1 were looked at" in html[last:]
    assert "/3" not in html[ladder : html.index("</section>", ladder)]  # one seed, not three
    assert ">stale</span>" in html[:last] and ">stale</span>" not in html[last:]
    assert "their code has changed since" in html


def test_the_ladder_says_how_each_rung_sees(run):
    path = run / "records.parquet"
    table = pq.read_table(path)
    for name, value in (("supervision", "labels of 8 clips"), ("knows", "exact disk")):
        table = table.append_column(name, pa.array([value] * len(table)))
    pq.write_table(table.append_column("context", pa.array([16] * len(table))), path)
    html = write_report(run).read_text()
    ladder = html[html.index('<section id="ladder">') :]
    ladder = ladder[: ladder.index("</section>")]
    for word in ("how it sees", "knows of the pictures", "labels of 8 clips", "exact disk"):
        assert word in ladder
    assert '<td class="said">16</td>' in ladder
    assert "how it sees" not in html[: html.index(ladder)]


def test_a_variant_stands_right_below_its_rung():
    names = ("i3d", "hiera-random", "videomae-tiny", "jepa-centroid-joint", "hiera", "mine", "jepa")
    rows = [{**row(0, None), "grounding": name} for name in names]
    assert [line.grounding for line in Records(rows).lines] == [
        "jepa",
        "jepa-centroid-joint",
        "hiera",
        "hiera-random",
        "i3d",
        "videomae-tiny",
        "mine",
    ]
