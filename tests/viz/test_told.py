"""The report of a training says at its top whether what was learned foretells."""

import json

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from viz.told import write_told


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (0.1, "<b>Holds:</b> the factored model foretells better than standing still"),
        (0.2, "<b>Open:</b>"),
    ],
)
def test_a_training_says_first_whether_it_foretells(tmp_path, error, said):
    (tmp_path / "run.json").write_text(json.dumps({"settings": {"experiment": "train"}}))
    errors = {"clip/factored": error, "clip/persistence": 0.15, "clip/constant-velocity": 0.3}
    rows = [
        {"cell": cell, "metric": "forecast_rmse_normalised", "value": value, "status": "ok"}
        for cell, value in errors.items()
    ]
    pq.write_table(pa.Table.from_pylist(rows), tmp_path / "records.parquet")
    page = write_told(tmp_path).read_text()
    assert said in page and f"RMSE {error:g} against 0.15" in page
