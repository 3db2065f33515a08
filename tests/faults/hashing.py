"""What it costs to check hashes: the share of a run's processor time that is spent in them.

``python -m tests.faults.hashing`` runs a training from a store that is filled, and a ladder cell of
a study that is far smaller than any that is meant, and prints what they spend in hashing.
"""

from __future__ import annotations

import hashlib
import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.shared.serial import serially
from tests.shared.small_clips import know_cells, write_clip
from tests.shared.small_studies import TINY
from vidphys import presets
from vidphys.cli import main
from vidphys.runs import pool

CLIPS, FRAMES = 3, 16


class Counted:
    """hashlib's objects and functions, with the seconds that are spent in them."""

    def __init__(self) -> None:
        self.seconds, self.patch = 0.0, pytest.MonkeyPatch()
        self.patch.setattr(hashlib, "file_digest", self._timed(hashlib.file_digest))
        self.patch.setattr(hashlib, "sha256", self._object(hashlib.sha256))

    def _timed(self, work: Callable) -> Callable:
        def call(*args, **options):
            began = time.thread_time()
            try:
                return work(*args, **options)
            finally:
                self.seconds += time.thread_time() - began

        return call

    def _object(self, make: Callable) -> Callable:
        counted = self

        class Digest:
            def __init__(self, data: bytes = b"") -> None:
                self.real = make()
                self.update(data)

            def update(self, data) -> None:
                counted._timed(self.real.update)(data)

            def hexdigest(self) -> str:
                return self.real.hexdigest()

            def digest(self) -> bytes:
                return self.real.digest()

        return Digest


def share(arguments: list[str]) -> tuple[float, float]:
    """Seconds of the processor of a verb, and those of them in hashing."""
    counted, began = Counted(), time.process_time()
    try:
        assert main(arguments) == 0
    finally:
        counted.patch.undo()
    return time.process_time() - began, counted.seconds


def run(folder: Path) -> dict[str, dict[str, float]]:
    pool.run_all, presets.PRESETS["quick"] = serially, TINY
    know_cells(pytest.MonkeyPatch())
    for k in range(CLIPS):
        write_clip(folder / "clips" / f"clip{k}.avi", FRAMES, phase=k)
    store = ["--store", str(folder / "features"), "--encoder", "cells", "--readout", "attention"]
    sizes = ["--steps", "12", "--head-steps", "4", "--shift", "1", "--quiet"]
    train = ["train", str(folder / "clips"), *store, *sizes]
    ladder = ["ladder", "--cells", "oracle/unstructured", "--workers", "1", "--quiet"]
    assert main([*train, "--out", str(folder / "before")]) == 0  # fills the store
    found = {}
    for name, asked in (("train from a store", train), ("ladder cell", ladder)):
        seconds, hashing = share([*asked, "--out", str(folder / name.split()[0])])
        found[name] = {"seconds": seconds, "hashing": hashing, "percent": 100 * hashing / seconds}
    return found


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        told = run(Path(made))
    print(json.dumps(told, indent=2))
    sys.exit(max(each["percent"] for each in told.values()) > 3)
