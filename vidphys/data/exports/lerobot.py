"""Episodes as a LeRobotDataset, version 3: one rate for all, the same columns in each."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from vidphys.data.evenness import JITTER, jitter
from vidphys.data.exports.episodes import Episode
from vidphys.errors import InputError

TABLE = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
FIRST = TABLE.format(chunk_index=0, file_index=0)
OWN = {
    "timestamp": "float32",
    **dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64"),
}


@dataclass
class _Sums:
    """What is kept of a column for its statistics, ``(...)`` each."""

    low: np.ndarray
    high: np.ndarray
    total: np.ndarray
    squares: np.ndarray
    count: int

    @classmethod
    def of(cls, values: np.ndarray) -> _Sums:
        x = values.astype(float)
        return cls(x.min(0), x.max(0), x.sum(0), np.square(x).sum(0), len(x))

    def plus(self, other: _Sums) -> _Sums:
        return _Sums(
            np.minimum(self.low, other.low),
            np.maximum(self.high, other.high),
            self.total + other.total,
            self.squares + other.squares,
            self.count + other.count,
        )

    def told(self) -> dict[str, Any]:
        mean = self.total / self.count
        spread = np.sqrt(np.maximum(self.squares / self.count - mean**2, 0))
        named = {"min": self.low, "max": self.high, "mean": mean, "std": spread}
        return {key: np.atleast_1d(x).tolist() for key, x in named.items()} | {
            "count": [self.count]
        }


def write_lerobot(folder: Path, episodes: Iterator[Episode]) -> int:
    """Write ``meta``, and the frames of all episodes in one table.

    Columns that not all episodes of the first one's kind have are left out. Episodes of another
    rate than the first, as rollouts in the model's own steps, are read off at the first one's.

    Returns:
        How many episodes were written.

    Raises:
        InputError: frames that come unevenly, or arrays of unlike shapes.
    """
    first, others = next(episodes, None), episodes
    if first is None:
        raise InputError("there are no episodes to write")
    every = [first, *others] if not _is_large(first) else None
    shared = list(first.columns) if every is None else _shared(every)
    fps, features = _rate(first), _features(first, shared)
    rows, tasks, sums = [], dict[str, int](), dict[str, _Sums]()
    (folder / FIRST).parent.mkdir(parents=True)
    (folder / EPISODES).parent.mkdir(parents=True)
    writer: pq.ParquetWriter | None = None
    begin = 0
    try:
        for number, episode in enumerate(every or _again(first, others)):
            even = _at_rate(episode, fps)
            task = tasks.setdefault(episode.task, len(tasks))
            table, own = _frames(even, shared, features, fps, (number, begin, task))
            for name, each in own.items():
                sums[name] = sums[name].plus(each) if name in sums else each
            writer = writer or pq.ParquetWriter(folder / FIRST, table.schema)
            writer.write_table(table)
            rows.append(_row(number, episode.task, begin, len(even.times)))
            begin += len(even.times)
    finally:
        if writer is not None:
            writer.close()
    pq.write_table(pa.Table.from_pylist(rows), folder / EPISODES)
    pq.write_table(_tasks(tasks), folder / "meta/tasks.parquet")
    _json(folder / "meta/info.json", _info(fps, features, len(rows), begin, len(tasks)))
    _json(folder / "meta/stats.json", {name: each.told() for name, each in sums.items()})
    return len(rows)


def _is_large(episode: Episode) -> bool:
    """Whether episodes are features, of which only one is held at a time."""
    return not episode.parts


def _again(first: Episode, others: Iterator[Episode]) -> Iterator[Episode]:
    yield first
    yield from others


def _shared(episodes: list[Episode]) -> list[str]:
    return [name for name in episodes[0].columns if all(name in e.columns for e in episodes)]


def _rate(episode: Episode) -> float:
    times = np.asarray(episode.times, float)
    if len(times) < 2 or jitter(times) > JITTER:
        raise InputError(
            f"{episode.name}: its frames come unevenly, and LeRobot knows one rate; write Parquet "
            "or WebDataset"
        )
    rate = float((len(times) - 1) / (times[-1] - times[0]))
    return round(rate) if abs(rate - round(rate)) < 1e-3 * rate else rate


def _at_rate(episode: Episode, fps: float) -> Episode:
    """The episode at this rate, on straight lines between its frames."""
    times = np.asarray(episode.times, float)
    if len(times) > 1 and abs(_rate(episode) / fps - 1) < JITTER:
        return episode
    grid = np.arange(times[0], times[-1] + 1e-6 / fps, 1 / fps)
    columns = {}
    for name, values in episode.columns.items():
        flat = values.reshape(len(values), -1)
        path = np.stack([np.interp(grid, times, column) for column in flat.T], -1)
        columns[name] = path.reshape(len(grid), *values.shape[1:])
    return replace(episode, times=grid, columns=columns)


def _features(episode: Episode, shared: list[str]) -> dict[str, Any]:
    own: dict[str, Any] = {}
    for name, kind in OWN.items():
        own[name] = {"dtype": kind, "shape": [1], "names": None}
    for name in shared:
        shape, parts = list(episode.columns[name].shape[1:]), episode.parts.get(name)
        names = None if parts is None else list(parts)
        own[_key(name)] = {"dtype": "float32", "shape": shape, "names": names}
    return own


def _key(name: str) -> str:
    return name if name.startswith("observation.") else f"observation.{name}"


def _frames(
    episode: Episode,
    shared: list[str],
    features: Mapping[str, Any],
    fps: float,
    numbers: tuple[int, int, int],
) -> tuple[pa.Table, dict[str, _Sums]]:
    number, begin, task = numbers
    t = len(episode.times)
    frame = np.arange(t)
    columns: dict[str, Any] = {}
    sums = {}
    for name in shared:
        values = episode.columns[name].astype(np.float32)
        if list(values.shape[1:]) != features[_key(name)]["shape"]:
            raise InputError(
                f"{episode.name}: {name} of {list(values.shape[1:])}, but the first episode has "
                f"{features[_key(name)]['shape']}; a LeRobotDataset has one shape: extract one "
                "layer of one encoder into a store, or write Parquet or WebDataset"
            )
        columns[_key(name)] = _nested(values)
        sums[_key(name)] = _Sums.of(values)
    own: dict[str, np.ndarray] = {
        "timestamp": (frame / fps).astype(np.float32),
        "frame_index": frame,
        "episode_index": np.full(t, number),
        "index": begin + frame,
        "task_index": np.full(t, task),
    }
    return pa.table(columns | own), sums | {name: _Sums.of(x) for name, x in own.items()}


def _nested(values: np.ndarray) -> pa.Array:
    """Vectors and larger arrays as lists of fixed sizes."""
    found: pa.Array = pa.array(np.ascontiguousarray(values).reshape(-1))
    for size in reversed(values.shape[1:]):
        found = pa.FixedSizeListArray.from_arrays(found, size)
    return found


def _row(number: int, task: str, begin: int, length: int) -> dict[str, Any]:
    return {
        "episode_index": number,
        "tasks": [task],
        "length": length,
        "data/chunk_index": 0,
        "data/file_index": 0,
        "dataset_from_index": begin,
        "dataset_to_index": begin + length,
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
    }


def _tasks(tasks: Mapping[str, int]) -> pa.Table:
    """The tasks as a table that pandas reads with the words as its index."""
    table = pa.table({"task_index": list(tasks.values()), "task": list(tasks)})
    about = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [
            {"name": "task_index", "field_name": "task_index", "pandas_type": "int64"}
            | {"numpy_type": "int64", "metadata": None},
            {"name": "task", "field_name": "task", "pandas_type": "unicode"}
            | {"numpy_type": "object", "metadata": None},
        ],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.0.0",
    }
    return table.replace_schema_metadata({"pandas": json.dumps(about)})


def _info(
    fps: float, features: Mapping[str, Any], episodes: int, frames: int, tasks: int
) -> dict[str, Any]:
    return {
        "codebase_version": "v3.0",
        "robot_type": None,
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{episodes}"},
        "data_path": TABLE,
        "video_path": None,
        "features": dict(features),
    }


def _json(path: Path, held: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(held, indent=4), encoding="utf-8")
