"""Episodes as Parquet: a row for each frame; one file for all episodes of the same columns."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from vidphys.data.exports.episodes import Episode


def write_tables(folder: Path, episodes: Iterator[Episode]) -> int:
    """Write ``frames.parquet``, and ``frames-2.parquet``, ... where columns differ.

    Columns: ``episode``, ``task``, ``frame_index``, ``time`` (seconds), and those of the episode:
    vectors by the names of their parts, larger arrays as lists whose ``shape`` stands in the
    column's metadata.

    Returns:
        How many episodes were written.
    """
    writers: dict[str, pq.ParquetWriter] = {}
    count = 0
    try:
        for episode in episodes:
            count += 1
            table = _table(episode)
            key = str([(field.name, field.metadata) for field in table.schema])
            if key not in writers:
                name = f"frames-{len(writers) + 1}.parquet" if writers else "frames.parquet"
                writers[key] = pq.ParquetWriter(folder / name, table.schema)
            writers[key].write_table(table)
    finally:
        for writer in writers.values():
            writer.close()
    return count


def _table(episode: Episode) -> pa.Table:
    t = len(episode.times)
    facts = {name: json.dumps(x) if isinstance(x, list) else x for name, x in episode.facts.items()}
    columns: dict[str, object] = {
        "episode": pa.array([episode.name] * t, pa.string()),
        "task": pa.array([episode.task] * t, pa.string()),
        **{name: [value] * t for name, value in facts.items()},
        "frame_index": pa.array(range(t), pa.int64()),
        "time": pa.array(np.asarray(episode.times, float)),
    }
    shapes = {}
    for name, values in episode.columns.items():
        parts = episode.parts.get(name)
        if parts is not None:
            columns |= {part: values[:, k] for k, part in enumerate(parts)}
        else:
            flat = pa.array(np.ascontiguousarray(values, np.float32).reshape(-1))
            columns[name] = pa.FixedSizeListArray.from_arrays(flat, int(np.prod(values.shape[1:])))
            shapes[name] = json.dumps(list(values.shape[1:]))
    table = pa.table(columns)
    fields = [
        f.with_metadata({"shape": shapes[f.name]} if f.name in shapes else {}) for f in table.schema
    ]
    return table.cast(pa.schema(fields))
