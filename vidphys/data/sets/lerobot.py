"""LeRobotDataset, version 3: films of many episodes, tables of frames, and where each begins.

::

    meta/info.json                             frames per second, features, splits, paths
    meta/episodes/chunk-000/file-000.parquet   a row for each episode: its files, times and frames
    data/chunk-000/file-000.parquet            a row for each frame of some episodes
    videos/CAMERA/chunk-000/file-000.mp4       the films of some episodes, one after the other

An episode as a camera sees it is a clip; numbers of its frames are columns of its labels, those of
a vector by the names that ``info.json`` gives them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from vidphys.boundary import Above, Word, is_below, read_json
from vidphys.data.clip_files import ClipFile, Dataset, Source
from vidphys.data.formats.bounded import MOST_COLUMNS, reading, require_room
from vidphys.data.labels import Labels
from vidphys.data.sets.apart import cells_of, rows_of
from vidphys.data.sets.base import MOST_CLIPS, SetFormat, facts_of, labels_of
from vidphys.data.sets.sources import part, pictures
from vidphys.errors import InputError

INFO = Path("meta") / "info.json"
EPISODES = Path("meta") / "episodes"
OWN = ("timestamp", "frame_index", "episode_index", "index", "task_index")
BLANK = re.compile(r"\{(video_key|chunk_index|file_index)(:0?\dd)?\}")
Rows = Callable[[], np.ndarray]  # numbers of those of an episode
Count = Annotated[int, Field(ge=0, le=10**9)]


class Feature(BaseModel):
    """A column of the frames, or a camera."""

    model_config = ConfigDict(frozen=True)
    dtype: Word
    shape: tuple[Count, ...] = ()
    names: Any = None


class Info(BaseModel):
    """What ``info.json`` says, of what is needed here."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    codebase_version: Word
    fps: Above
    features: Annotated[dict[str, Feature], Field(max_length=1000)]
    splits: Annotated[dict[str, Word], Field(max_length=100)] = {}
    data_path: Word
    video_path: Word | None = None


def looks(path: Path) -> bool:
    """Whether a folder is of this kind."""
    return (path / INFO).is_file()


def read(path: Path) -> Dataset:
    """The episodes, by each camera."""
    info = read_json(path / INFO, Info, "the info.json of a LeRobotDataset")
    if not info.codebase_version.startswith("v3"):
        raise InputError(
            f"LeRobotDataset {info.codebase_version}; version 3 is read: convert it with LeRobot's "
            "convert_dataset_v21_to_v30"
        )
    cameras = [k for k, each in info.features.items() if each.dtype in ("video", "image")]
    if not cameras:
        raise InputError("no camera among its features")
    files, stored = [], []
    for episode in _episodes(path):
        with reading("an episode"):
            number = int(episode["episode_index"])
            require_room((int(episode["length"]),), 8, "times")
        table = _below(path, _path(info.data_path, episode, "data"))
        rows = partial(_frames, table, number)
        stored.append(table)
        for camera in cameras:
            source, film = _seen(path, info, episode, camera, rows, table)
            stored += film
            name = path / str(number) / camera if len(cameras) > 1 else path / str(number)
            files.append(
                ClipFile(
                    name,
                    _labels(info, table, rows),
                    facts={**facts_of(_plain(episode)), "camera": camera},
                    split=_split(info, number),
                    source=source,
                )
            )
    return Dataset(tuple(files), stored=tuple(dict.fromkeys(stored)))


def _episodes(path: Path) -> Iterator[dict[str, Any]]:
    tables = sorted((path / EPISODES).glob("chunk-*/file-*.parquet"))
    count = 0
    for file in tables:
        table = rows_of(_below(path, file.relative_to(path)), "parquet")
        count += table.count
        if count > MOST_CLIPS:
            raise InputError(f"more than {MOST_CLIPS} episodes")
        yield from map(table.values, range(table.count))


def _plain(episode: dict[str, Any]) -> dict[str, Any]:
    """What is said of an episode beside where it lies."""
    tasks = episode.get("tasks")
    task = tasks[0] if isinstance(tasks, np.ndarray) and tasks.size else ""
    held = {k: v for k, v in episode.items() if "/" not in k and not k.startswith("dataset_")}
    return {**held, "task": task}


def _path(form: str, episode: dict[str, Any], of: str, **more: str) -> Path:
    if set(BLANK.sub("", form)) & set("{}"):
        raise InputError(f"the path {form!a} in info.json has other blanks than LeRobot's")
    with reading("the paths of an episode"):
        where = {name: int(episode[f"{of}/{name}"]) for name in ("chunk_index", "file_index")}
        return Path(form.format(**where, **more))


def _below(path: Path, file: Path) -> Path:
    whole = path / file
    if not is_below(whole, path) or not whole.is_file():
        raise InputError(f"{str(file)!a} is not in this data set")
    return whole


def _seen(
    path: Path, info: Info, episode: dict[str, Any], camera: str, rows: Rows, table: Path
) -> tuple[Source, list[Path]]:
    count = int(episode["length"])
    times = np.arange(count) / info.fps
    if info.features[camera].dtype == "image":
        return pictures(partial(_pictures, table, rows, camera), times), []
    if info.video_path is None:
        raise InputError(f"{camera} is a film, but info.json has no video_path")
    film = _below(path, _path(info.video_path, episode, f"videos/{camera}", video_key=camera))
    with reading("the times of an episode"):
        begin = float(episode[f"videos/{camera}/from_timestamp"])
    return part(film, begin, times), [film]


def _pictures(table: Path, rows: Rows, camera: str) -> Iterator[bytes]:
    """Those of an episode, as they are stored."""
    wanted = rows().tolist()
    for number, cell in enumerate(cells_of(table, "parquet", camera, wanted)):
        if not isinstance(cell, bytes):
            raise InputError(f"frame {number} of {camera} holds no picture")
        yield cell


def _frames(path: Path, episode: int) -> np.ndarray:
    """The rows of an episode, in the order of its frames."""
    with reading("a table of frames"):
        held = rows_of(path, "parquet").columns
        found = np.flatnonzero(held["episode_index"] == episode)
        return found[np.argsort(np.asarray(held["frame_index"])[found], kind="stable")]


def _labels(info: Info, path: Path, rows: Rows) -> Labels | None:
    """Labels in the numbers of frames."""
    names = {}
    for key, feature in info.features.items():
        if key in OWN or feature.dtype in ("video", "image", "string"):
            continue
        size = int(np.prod(feature.shape)) if feature.shape else 1
        parts = _names(feature.names, size)
        for k in range(size):
            own = parts[k] if parts else key if size == 1 else f"{key}.{k}"
            names[own if own not in names else f"{key}.{own}"] = key, k
        if len(names) > MOST_COLUMNS:
            raise InputError(f"more than {MOST_COLUMNS} numbers a frame")

    def load() -> dict[str, np.ndarray]:
        table, own = rows_of(path, "parquet").columns, rows()
        vectors = {key: np.asarray(table[key], float)[own] for key, _ in names.values()}
        flat = {key: x.reshape(len(x), -1) for key, x in vectors.items()}
        held = {name: flat[key][:, k] for name, (key, k) in names.items()}
        return {"time": np.asarray(table["timestamp"])[own], **held}

    return labels_of("features of the frames", dict.fromkeys(["time", *names]), load)


def _names(names: Any, size: int) -> list[str]:
    """Names of a vector's parts, as a list or below some word."""
    if isinstance(names, dict):
        names = next(iter(names.values()), None)
    if isinstance(names, list) and len(names) == size and all(isinstance(n, str) for n in names):
        return names
    return []


def _split(info: Info, episode: int) -> str:
    """The split of an episode: ranges such as ``0:50``."""
    for name, text in info.splits.items():
        for piece in text.split(","):
            first, colon, stop = piece.strip().partition(":")
            whole = colon and first.isdecimal() and stop.isdecimal()
            if whole and int(first) <= episode < int(stop):
                return name
    return ""


LEROBOT = SetFormat(looks, read)
