"""Copies of a feature store in an object store, or anywhere that fsspec reaches by a URL.

A store that has been packed is a few large objects: shards, to which bytes are only ever appended,
and indexes, which are copied last so that none names what is not there yet. As with git, a copy
says what it is of: whoever pushes must have pulled what is there, and whoever pulls must have
nothing that is not there. Two who push at the same instant are not kept apart.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from encoders.placing import placed
from encoders.release import file_sha256
from encoders.shards import OWN
from encoders.store import FeatureStore

STATE = "copied.json"  # here and there: the hash of each index when it was last copied
INDEX = ".sqlite"


class Remote:
    """A copy of a store.

    Args:
        url: of its folder, such as ``s3://bucket/features``.
        options: of the file system, such as its endpoint; else what its package takes from the
            surroundings.

    Raises:
        ValueError: no package for such a URL.
    """

    def __init__(self, url: str, **options: Any) -> None:
        from fsspec.core import url_to_fs

        try:
            self.files, root = url_to_fs(url, **options)
        except (ImportError, ValueError) as error:
            raise ValueError(f"`url` {url}: {error}; s3:// needs the package s3fs") from error
        self.url, self.root = url, f"{root.rstrip('/')}/shards"

    def push(self, store: FeatureStore) -> int:
        """Copy there what it lacks; entries that are files of their own are packed first.

        Returns:
            Bytes that were copied.

        Raises:
            ValueError: somebody else pushed what this store has not pulled.
        """
        store.pack()
        folder, copied = store.shards.folder, 0
        folder.mkdir(parents=True, exist_ok=True)
        with store.shards.alone():
            now, there = _indexes(folder), self._state()
            if there.get(OWN) not in (None, _known(folder).get(OWN), now.get(OWN)):
                raise ValueError(
                    f"feature store {folder.parent}: {self.url} was changed since it was last "
                    "copied from or to here; pull it into another folder"
                )
            sizes = self._sizes()
            for path in _in_order(folder):
                name, size = path.relative_to(folder).as_posix(), path.stat().st_size
                if _is_index(name):
                    same = now[path.stem] == there.get(path.stem)
                else:
                    same = sizes.get(name) == size
                if not same:
                    self.files.makedirs(f"{self.root}/{name}".rpartition("/")[0], exist_ok=True)
                    self.files.put_file(str(path), f"{self.root}/{name}")
                    copied += size
            said = json.dumps({**there, **now})
            self.files.pipe_file(f"{self.root}/{STATE}", said.encode())
            _remember(folder, said)
        return copied

    def pull(self, store: FeatureStore) -> int:
        """Copy here what is not here.

        Returns:
            Bytes that were copied.

        Raises:
            ValueError: nothing is there, or this store has entries that are not there.
        """
        folder, there, copied = store.shards.folder, self._state(), 0
        if not there:
            raise ValueError(f"`url` {self.url}: no feature store; `vidphys store push` one")
        folder.mkdir(parents=True, exist_ok=True)
        with store.shards.alone():
            now = _indexes(folder)
            if now.get(OWN) not in (None, _known(folder).get(OWN), there.get(OWN)):
                raise ValueError(
                    f"feature store {folder.parent}: has entries that {self.url} does not have; "
                    "push them, or pull into another folder"
                )
            for name, size in sorted(self._sizes().items(), key=lambda each: _is_index(each[0])):
                path = folder / name
                if _is_index(name):
                    same = now.get(path.stem) == there.get(path.stem)
                else:
                    same = path.is_file() and path.stat().st_size == size
                if same or name == STATE:
                    continue
                with placed(path) as partial:
                    self.files.get_file(f"{self.root}/{name}", str(partial))
                    if _is_index(name) and file_sha256(partial) != there.get(path.stem):
                        raise ValueError(f"{self.url} is being changed; pull it again")
                copied += size
            _remember(folder, json.dumps(there))
        return copied

    def _sizes(self) -> dict[str, int]:
        """What is there, by its path below the folder."""
        self.files.invalidate_cache()
        begin = len(self.root.lstrip("/")) + 1
        found = self.files.find(self.root, detail=True)
        return {name.lstrip("/")[begin:]: about["size"] for name, about in found.items()}

    def _state(self) -> dict[str, str]:
        try:
            return json.loads(self.files.cat_file(f"{self.root}/{STATE}"))
        except FileNotFoundError:
            return {}


def _in_order(folder: Path) -> Iterator[Path]:
    """What is copied: what indexes name, then the indexes, the own one last."""
    indexes = sorted(folder.glob(f"[!.]*{INDEX}"), key=lambda path: path.stem == OWN)
    yield from sorted(folder.glob("*.bin"))
    for index in indexes:
        yield from sorted(p for p in folder.glob(f"{index.stem}/**/*") if p.is_file())
    yield from indexes


def _is_index(name: str) -> bool:
    return name.endswith(INDEX)


def _indexes(folder: Path) -> dict[str, str]:
    return {path.stem: file_sha256(path) for path in folder.glob(f"[!.]*{INDEX}")}


def _known(folder: Path) -> dict[str, str]:
    """What was last copied from or to here."""
    path = folder / STATE
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def _remember(folder: Path, said: str) -> None:
    with placed(folder / STATE) as partial:
        partial.write_text(said, encoding="utf-8")
