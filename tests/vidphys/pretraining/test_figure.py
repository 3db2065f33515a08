"""What training adds to encoders, drawn from the records of an atlas."""

from __future__ import annotations

import sys
from pathlib import Path

import pyarrow as pa
import pytest

from vidphys.errors import InputError
from vidphys.pretraining import figure
from vidphys.pretraining.figure import gains, table
from vidphys.runs.records import write_table

# encoder and layer, scores with their intervals: trained, with random weights, and of the pixels
FOUND = {
    "one/1": ((0.2, 0.1, 0.3), (0.15, 0.1, 0.2), 0.4),
    "one/2": ((0.5, 0.4, 0.6), (0.05, -0.1, 0.1), 0.4),
    "two/1": ((0.1, 0.0, 0.2), (-0.001, -0.2, 0.2), 0.4),
}


def records(seed: int = 0) -> list[dict[str, object]]:
    rows = []
    for place, (trained, random, pixels) in FOUND.items():
        about = {"experiment": "atlas", "encoder": place.split("/")[0], "seed": seed}
        about |= {"role": "development"}
        rows.append({**about, "cell": place, "metric": "ms_per_clip", "value": 3.0})
        for name, found in (("score", trained), ("control/random-weights", random)):
            for end, value in zip(("", "_low", "_high"), found, strict=True):
                metric = {"cell": f"{place}/speed", "metric": f"{name}{end}", "value": value}
                rows.append({**about, **metric})
        for end in ("", "_low", "_high"):
            metric = {"cell": f"{place}/speed", "metric": f"control/pixels{end}", "value": pixels}
            rows.append({**about, **metric})
    return rows


def test_each_is_read_at_the_layer_that_knows_most() -> None:
    one, two = gains(records())
    assert (one.encoder, one.trained.value, one.random.value) == ("one", 0.5, 0.15)
    assert (two.encoder, two.trained.low, two.pixels) == ("two", 0.0, 0.4)
    assert table([one, two]).splitlines()[2:] == [
        "| speed | `one` | 0.50 [0.40, 0.60] | 0.15 [0.10, 0.20] | 0.40 |",
        "| speed | `two` | 0.10 [0.00, 0.20] | 0.00 [−0.20, 0.20] | 0.40 |",
    ]


def test_the_figure_says_what_it_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_table(tmp_path / "records.parquet", pa.Table.from_pylist(records()))
    out = tmp_path / "figure.svg"
    monkeypatch.setattr(sys, "argv", ["figure", str(tmp_path), "--out", str(out)])
    assert figure.main() == 0
    assert "| speed | `one` |" in capsys.readouterr().out
    drawn = out.read_text(encoding="utf-8")
    for word in ("one", "two", "speed", "trained", "random weights", "seed 0 (development)"):
        assert f">{word}" in drawn or f"{word}," in drawn
    assert figure.main() == 0
    assert out.read_text(encoding="utf-8") == drawn


def test_what_is_no_atlas_of_one_seed_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for rows in ([], records() + records(1), [{**records()[0], "experiment": "ladder"}]):
        with pytest.raises(InputError, match="with one seed"):
            gains(rows)
    monkeypatch.setattr(sys, "argv", ["figure", str(tmp_path), "--out", str(tmp_path / "f.svg")])
    assert figure.main() == 2
    assert "records.parquet is not there" in capsys.readouterr().err
