"""F1, F4: a machine that goes down between any two file operations, and what was not synced goes.

A run folder and a feature store are driven at random on a disk that remembers, of each file and of
each name, what would still be there after a power cut: bytes that were synced, and names at once
(as file systems that journal names keep them, in order).
"""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
from pathlib import Path

import pyarrow as pa
import pytest
import torch
from hypothesis import settings as given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from encoders.features import FeatureMap
from encoders.identity import EncoderIdentity
from encoders.store import FeatureRequest, FeatureStore
from vidphys.errors import InputError
from vidphys.runs import checkpoint
from vidphys.runs.folder import RunFolder

KINDS = {"a": {"kind": "a", "cells": [], "seeds": []}, "b": {"kind": "b", "cells": [], "seeds": []}}
PARTS = ("p", "q")
IDENTITY = EncoderIdentity("mine", 1, "0" * 64, "none", "last", 32, "float32")


class PowerCut(BaseException):
    """Nothing runs after it."""


class Disk:
    """Counts the operations that change names, syncs among them; loses bytes that were not synced.

    A file is known by its inode, so that what is renamed keeps what was synced of it.
    """

    def __init__(self, root: Path) -> None:
        self.root, self.left = root, None
        self.synced: dict[int, bytes] = {}
        self.counting = threading.Lock()
        self.patch = pytest.MonkeyPatch()
        sync = os.fsync

        def fsync(number: int) -> None:
            self._count()
            sync(number)
            self.synced[os.fstat(number).st_ino] = os.pread(number, 2**24, 0)

        self.patch.setattr(os, "fsync", fsync)
        for name in ("rename", "replace", "unlink", "mkdir", "rmdir"):
            self.patch.setattr(Path, name, self._counted(getattr(Path, name)))

    def _counted(self, operation):
        def call(*args, **options):
            self._count()
            return operation(*args, **options)

        return call

    def _count(self) -> None:
        with self.counting:  # files are synced side by side
            if self.left is not None:
                if self.left == 0:
                    raise PowerCut
                self.left -= 1

    def lose(self) -> None:
        """After a power cut: of each file what was synced of it; a name without bytes is empty."""
        self.left = None
        for path in self.root.rglob("*"):
            if path.is_file() and not path.is_symlink() and path.name != ".lock":
                path.write_bytes(self.synced.get(path.stat().st_ino, b""))


class Runs(RuleBasedStateMachine):
    """What was finished before a cut is whole after it; what was not is not there."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp())
        self.disk = Disk(self.folder)
        self.kind: str | None = None
        self.done: dict[str, float] = {}
        self.steps: dict[str, int] = {}
        self.stored: set[int] = set()

    def teardown(self) -> None:
        self.disk.patch.undo()
        shutil.rmtree(self.folder)

    def cut_after(self, operations: int | None, work) -> bool:
        """Whether the work ended; a cut after so many operations loses what was not synced."""
        self.disk.left = operations
        try:
            work()
            self.disk.left = None
            return True
        except PowerCut:
            self.disk.lose()
            return False

    @property
    def run(self) -> Path:
        return self.folder / "run"

    @initialize()
    def begin(self) -> None:
        RunFolder.open(self.run, KINDS["a"])
        self.kind = "a"

    @rule(kind=st.sampled_from("ab"), overwrite=st.booleans(), cut=st.none() | st.integers(0, 14))
    def reopen(self, kind: str, overwrite: bool, cut: int | None) -> None:
        def work() -> None:
            RunFolder.open(self.run, KINDS[kind], overwrite)

        try:
            ended = self.cut_after(cut, work)
        except InputError as error:
            self.disk.left = None
            assert "other settings" in str(error)
            assert kind != self.kind
            assert not overwrite
            return
        if kind != self.kind:
            assert overwrite or not ended
            self._settle(ended, kind)

    def _settle(self, ended: bool, kind: str) -> None:
        """After a run was given up, or nearly: it is one or the other, and whole."""
        try:
            RunFolder.open(self.run, KINDS[self.kind])
            assert not ended
        except InputError:
            RunFolder.open(self.run, KINDS[kind])
            self.kind, self.done, self.steps = kind, {}, {}

    @rule(part=st.sampled_from(PARTS), value=st.floats(0, 1), cut=st.none() | st.integers(0, 8))
    def finish(self, part: str, value: float, cut: int | None) -> None:
        run = RunFolder(self.run)
        if run.is_done(part):
            return
        table = pa.table({"value": [value], "seed": pa.array([0], pa.int64())})
        if self.cut_after(cut, lambda: run.finish(part, table, table)) or run.is_done(part):
            self.done[part] = value

    @rule(cut=st.none() | st.integers(0, 12))
    def save(self, cut: int | None) -> None:
        path = self.run / "checkpoints" / "c.json"
        step = self.steps.get("c", 0) + 1
        state = {"w": torch.full((4,), float(step))}
        ended = self.cut_after(cut, lambda: checkpoint.save(path, state, {"step": step}, True))
        if ended or (path.exists() and checkpoint.load(path)[1]["step"] == step):
            self.steps["c"] = step

    @rule(number=st.integers(0, 2), cut=st.none() | st.integers(0, 8))
    def extract(self, number: int, cut: int | None) -> None:
        store, request = FeatureStore(self.folder / "store"), self._request(number)
        made = FeatureMap(
            torch.full((1, 1, 2, 1, 1), float(number)), (16.0, 16.0), torch.tensor([0.0])
        )
        if self.cut_after(cut, lambda: store.get(request, "clip", lambda: made)):
            self.stored.add(number)

    def _request(self, number: int) -> FeatureRequest:
        return FeatureRequest(IDENTITY, str(number) * 64, (0,), (0.0,), (32, 32))

    @invariant()
    def what_was_finished_is_whole(self) -> None:
        if self.kind is None:
            return
        run = RunFolder(self.run)
        assert run.manifest()["settings"]["kind"] == self.kind
        for part in PARTS:
            assert run.is_done(part) == (part in self.done)
        if self.done:
            assert sorted(run.join()["value"].to_pylist()) == sorted(self.done.values())
        if "c" in self.steps:
            tensors, meta = checkpoint.load(self.run / "checkpoints" / "c.json")
            assert meta["step"] == self.steps["c"]
            assert tensors["w"].tolist() == [float(meta["step"])] * 4
        for number in self.stored:
            found = FeatureStore(self.folder / "store").read(self._request(number))
            assert found is not None
            assert found.values.flatten().tolist() == [float(number)] * 2


LONG = int(os.environ.get("VIDPHYS_FAULTS", "0"))
TestRuns = Runs.TestCase
TestRuns.settings = given(
    max_examples=20 * LONG or 12, stateful_step_count=20, deadline=None, derandomize=True
)
TestRuns = pytest.mark.timeout(3000 if LONG else 300)(TestRuns)
