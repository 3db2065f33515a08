"""The run folder: what a run was, what it found, and where it goes on after an interruption.

``run.json`` is written first. Each finished piece of work leaves its two tables in ``parts/``;
``records.parquet`` and ``episodes.parquet`` are joined from these, so a piece is there whole or
not at all. Each names the code that made it; one that other code goes on with is marked.
"""

from __future__ import annotations

import shutil
import warnings
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa

from vidphys.errors import InputError
from vidphys.runs.aside import forget, is_ours, move_aside, settle, sweep
from vidphys.runs.code import code_version
from vidphys.runs.cost import Cost, marked
from vidphys.runs.lock import LOCK, locked
from vidphys.runs.origin import made_here, maker_of, with_origin
from vidphys.runs.records import read_table, write_table
from vidphys.runs.sealed import read_sealed, write_sealed
from vidphys.runs.settings import are_of_one_run, extended
from vidphys.runs.surroundings import mark_mixed, surroundings

SCHEMA_VERSION = 2
UNSEALED = 1  # the schema of before run.json held a hash of itself
FOLDERS = (
    "parts",
    "checkpoints",
    "showcase",
    "recordings",
    "figures",
    "clips",
    "truth",
    "outcomes",
    "logs",
    "jobs",
)
FILES = (
    "run.json",
    "records.parquet",
    "episodes.parquet",
    "report.html",
    "comparison.html",
    "play.json",
    "dataset.json",
    "index.json",
    "rollout.npz",
    "verdicts.json",
    "points.parquet",
    "profile.json",
    "summary.txt",
    "diagnosis.json",
    "specification.json",
    "tracks.csv",
    "atlas.json",
)


class MixedCodeWarning(UserWarning):
    """A run goes on under other code than made what lies there."""


class RunFolder:
    """One run on disk.

    Example:
        >>> import tempfile
        >>> where = Path(tempfile.mkdtemp()) / 'run'
        >>> run = RunFolder.open(where, {'cells': ['a'], 'seeds': [0]})
        >>> again = RunFolder.open(where, {'cells': ['b'], 'seeds': [0]})  # extends it
        >>> again.manifest()['settings']['cells'], run.is_done('a-s0')
        (['a', 'b'], False)
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def existing(cls, path: Path) -> RunFolder:
        """The run that lies in a folder.

        Raises:
            InputError: there is none.
        """
        run = cls(path)
        if not run.manifest_path.is_file():
            raise InputError(f"{path}: not the folder of a run; it has no run.json")
        return run

    @classmethod
    def open(cls, path: Path, settings: dict[str, Any], overwrite: bool = False) -> RunFolder:
        """As :meth:`at_work`, but hold the folder only while it is prepared."""
        with cls.at_work(path, settings, overwrite) as run:
            return run

    @classmethod
    @contextmanager
    def at_work(
        cls,
        path: Path,
        settings: dict[str, Any],
        overwrite: bool = False,
        threads: int | None = None,
    ) -> Iterator[RunFolder]:
        """Start a run, or go on with the one that lies there, and hold it for this process.

        Nothing is read, written or deleted before the folder is held. More cells, seeds and rungs
        extend a run; anything else that differs makes another run. Where other code goes on with
        one, a :class:`MixedCodeWarning` says so, and ``run.json`` lists the versions as
        ``mixed_code``; other packages, threads or instructions are marked likewise, as ``mixed``.

        Args:
            path: the folder.
            settings: the resolved configuration, with lists ``cells`` and ``seeds`` and, where
                there are any, the settings of each of the ``rungs``.
            overwrite: give up what lies there if it is another run: it is moved aside, and deleted
                when the work has ended well.
            threads: that compute, where it is not this process with torch's number of them; 0 where
                torch computes nothing.

        Raises:
            InputError: another process is at work there, another run lies there, or something
                that is not a run, or nothing can be written there.
        """
        run = cls(path)
        run._refuse_strangers()
        with locked(path):
            run._refuse_strangers()
            sweep(path, FOLDERS)
            settle(path)
            run._begin(settings, overwrite, threads)
            yield run
            if path.exists():  # else the run was abandoned
                forget(path)

    def _refuse_strangers(self) -> None:
        try:
            names = [] if self.manifest_path.exists() else list(self.path.iterdir())
        except FileNotFoundError:
            return
        except OSError as error:
            raise InputError(
                f"run folder {self.path}: cannot be read ({error.strerror}); choose another"
            ) from error
        if any(not is_ours(path) and path.name != LOCK for path in names):
            raise InputError(f"run folder {self.path}: exists and is not a run; choose another")

    def _begin(self, settings: dict[str, Any], overwrite: bool, threads: int | None) -> None:
        if self.manifest_path.exists():
            manifest = self.manifest()
            if are_of_one_run(manifest["settings"], settings):
                manifest["settings"] = extended(manifest["settings"], settings)
                self._tell_mixed_code(manifest)
                mark_mixed(self.path, manifest, threads)
                self._keep(manifest)
                return
            if not overwrite:
                raise InputError(
                    f"run folder {self.path}: holds a run with other settings; choose another, or "
                    "`overwrite` to give that run up"
                )
            move_aside(self.path, (*FOLDERS, *FILES))
        made = {**surroundings(threads), "code_version": code_version()}
        self._keep({**made, "settings": settings, "skipped": []})

    @property
    def manifest_path(self) -> Path:
        return self.path / "run.json"

    def manifest(self) -> dict[str, Any]:
        """The content of ``run.json``.

        Raises:
            InputError: it cannot be read, or a newer vidphys wrote it.
        """
        keys = ("schema_version", "settings")
        todo = f"restore it, or move {self.path} away and start anew"
        return read_sealed(self.manifest_path, "a run", todo, SCHEMA_VERSION, keys, UNSEALED)

    def _keep(self, manifest: dict[str, Any]) -> None:
        write_sealed(
            self.manifest_path, {**manifest, "schema_version": SCHEMA_VERSION}, SCHEMA_VERSION
        )

    def checkpoints(self, part: str) -> Path:
        """Folder of a part's checkpoints."""
        return self.path / "checkpoints" / part

    def showcase(self, cell: str) -> Path:
        """File of the arrays that a cell's recording is drawn from."""
        return self.path / "showcase" / (cell.replace("/", "-") + ".safetensors")

    def log(self, part: str) -> Path:
        """File in which a unit of work keeps what it says; it has the name of its first part."""
        return self.path / "logs" / (part.replace("/", "-") + ".log")

    @property
    def jobs(self) -> Path:
        """Folder of what an engine keeps for its jobs, while they run."""
        return self.path / "jobs"

    def is_done(self, part: str) -> bool:
        """Whether a piece of work has already left its tables."""
        return self._part(part, "records").exists()

    def finish(
        self,
        part: str,
        records: pa.Table,
        episodes: pa.Table,
        makers: tuple[str, ...] = (),
        cost: Cost | None = None,
    ) -> None:
        """Keep the tables of one piece of work; the records are what marks it as done.

        Args:
            part: its name.
            records, episodes: its tables.
            makers: modules that define what made it, see :func:`vidphys.runs.code.code_hash`.
            cost: what it took, where that is known.
        """
        made = made_here(makers)
        write_table(self._part(part, "episodes"), episodes.replace_schema_metadata(made))
        made |= marked(cost)
        write_table(self._part(part, "records"), records.replace_schema_metadata(made))

    def parts(self) -> Iterator[pa.Table]:
        """The records of each finished part, with its metadata."""
        for file in sorted((self.path / "parts").glob("*.records.parquet")):
            yield read_table(file)

    def made_by(self) -> dict[str, str]:
        """The code that made each finished part, where it says so."""
        end = ".records.parquet"
        files = sorted((self.path / "parts").glob(f"*{end}"))
        found = {f.name.removesuffix(end): maker_of(read_table(f)) for f in files}
        return {name: version for name, version in found.items() if version is not None}

    def _tell_mixed_code(self, manifest: dict[str, Any]) -> None:
        """Warn, and mark the manifest, if other code made what is there."""
        now, begun, parts = (
            code_version(),
            manifest["code_version"],
            Counter(self.made_by().values()),
        )
        others = sorted({begun, *parts} - {now})
        if others:
            manifest["mixed_code"] = sorted({now, *others, *manifest.get("mixed_code", ())})
            count = sum(parts[version] for version in others)
            warnings.warn(
                f"run folder {self.path}: this is code {now}; the run was begun, or parts of it "
                f"made ({count} of {parts.total()}), by {', '.join(others)}; run.json says so; "
                "start anew where the two must not mix",
                MixedCodeWarning,
                stacklevel=5,
            )

    def join(self) -> pa.Table:
        """Rebuild the two tables from the parts; returns the records.

        Each row then says what its seed is for (``role``), which code made it, and whether any
        that could have made it has changed since (``stale``); ``run.json`` says which code made
        which part.
        """
        tables = {}
        for kind in ("records", "episodes"):
            files = sorted((self.path / "parts").glob(f"*.{kind}.parquet"))
            if files:
                parts = [with_origin(read_table(f)) for f in files]
                tables[kind] = pa.concat_tables(parts, promote_options="default")
                write_table(self.path / f"{kind}.parquet", tables[kind])
        if "records" not in tables:
            raise InputError(f"run folder {self.path}: no finished work to report")
        self._keep({**self.manifest(), "made_by": self.made_by()})
        return tables["records"]

    def tell(self, **found: Any) -> None:
        """Keep in ``run.json`` what the work found out about its input."""
        manifest = self.manifest()
        if manifest != (told := {**manifest, **found}):
            self._keep(told)

    def skip(self, cell: str, reason: str) -> None:
        """Note in ``run.json`` why a cell was not run."""
        manifest = self.manifest()
        entry = {"cell": cell, "reason": reason}
        if entry not in manifest["skipped"]:
            manifest["skipped"].append(entry)
            self._keep(manifest)

    def unskip(self, cells: Collection[str]) -> None:
        """Take back what ``run.json`` says of cells that were run after all."""
        manifest = self.manifest()
        kept = [entry for entry in manifest["skipped"] if entry["cell"] not in cells]
        if kept != manifest["skipped"]:
            self._keep({**manifest, "skipped": kept})

    def abandon(self) -> None:
        """Leave nothing of a run that could not begin; one with finished work is kept.

        A run that was given up for it comes back. The folder stays where somebody keeps other
        files in it.
        """
        if (self.path / "parts").exists():
            return
        for name in FOLDERS:
            shutil.rmtree(self.path / name, ignore_errors=True)
        for name in sorted(FILES, key=lambda name: name == self.manifest_path.name):
            (self.path / name).unlink(missing_ok=True)
        settle(self.path)
        if not self.manifest_path.exists():
            (self.path / LOCK).unlink(missing_ok=True)
        if not any(self.path.iterdir()):
            self.path.rmdir()

    def _part(self, part: str, kind: str) -> Path:
        return self.path / "parts" / f"{part.replace('/', '-')}.{kind}.parquet"
