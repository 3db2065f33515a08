"""Episodes as WebDataset: tar files of samples, ``NAME.json`` and ``NAME.COLUMN.npy``."""

from __future__ import annotations

import io
import json
import re
import tarfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from vidphys.data.exports.episodes import Episode

SHARD = 2**30  # bytes of a tar, about


def write_shards(folder: Path, episodes: Iterator[Episode]) -> int:
    """Write ``episodes-000000.tar`` and so on, a sample for each episode.

    The JSON has the task, the seconds of each frame as ``time``, the facts, and vectors by the
    names of their parts; other arrays, ``(t, ...)``, are NumPy's.

    Returns:
        How many episodes were written.
    """
    count, shard, used = 0, 0, SHARD + 1
    archive: tarfile.TarFile | None = None
    try:
        for episode in episodes:
            count += 1
            if used > SHARD or archive is None:
                if archive is not None:
                    archive.close()
                path = folder / f"episodes-{shard:06d}.tar"
                archive, used = tarfile.open(path, "w"), 0  # noqa: SIM115 - closed below
                shard += 1
            for name, data in _files(episode):
                member = tarfile.TarInfo(name)
                member.size = len(data)
                archive.addfile(member, io.BytesIO(data))
                used += len(data)
    finally:
        if archive is not None:
            archive.close()
    return count


def _files(episode: Episode) -> Iterator[tuple[str, bytes]]:
    key = re.sub(r"[^\w-]", "_", episode.name)
    about = {"task": episode.task, "time": episode.times.tolist(), **episode.facts}
    for name, values in episode.columns.items():
        parts = episode.parts.get(name)
        if parts is None:
            data = io.BytesIO()
            np.save(data, np.ascontiguousarray(values), allow_pickle=False)
            yield f"{key}.{name.rpartition('.')[2]}.npy", data.getvalue()
        else:
            about |= {part: values[:, k].tolist() for k, part in enumerate(parts)}
    yield f"{key}.json", json.dumps(about).encode()
