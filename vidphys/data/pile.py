"""Frames one after the other in one array, so that a clip is held once, and not without bound."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vidphys.errors import InputError

MAX_BYTES = 8 * 2**30
SHARE = 0.5  # of the memory that is free
GROWTH = 8  # a pile that is full grows by one part in so many
FIRST = 16  # frames
FREE, GROUP = Path("/proc/meminfo"), Path("/sys/fs/cgroup")


class Pile:
    """Frames of one size, in the order in which they are added.

    Args:
        path: of the clip that they are of, for what is said of it.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.count = path, 0
        self.most = min(MAX_BYTES, int(SHARE * free_memory()))
        self.frames = np.empty((0, 0, 0, 3), np.uint8)

    def add(self, frame: np.ndarray) -> None:
        """Put a frame ``(H, W, 3)``, bytes, on the pile.

        Raises:
            InputError: of another size than those before it, or more than may be held.
        """
        if not self.count:
            self.frames = np.empty((0, *frame.shape), np.uint8)
        elif frame.shape != self.frames.shape[1:]:
            raise InputError(
                f"{self.path}: frame {self.count} is {frame.shape[1]} x {frame.shape[0]} pixels, "
                f"the first was {self.frames.shape[2]} x {self.frames.shape[1]}; convert the clip"
            )
        if self.count == len(self.frames):
            self._grow(frame.nbytes)
        self.frames[self.count] = frame
        self.count += 1

    def whole(self) -> np.ndarray:
        """All frames, ``(t, H, W, 3)``; the pile is done with."""
        self.frames.resize((self.count, *self.frames.shape[1:]), refcheck=False)
        return self.frames

    def _grow(self, each: int) -> None:
        """More room at the end, which moves nothing where the system can map it elsewhere."""
        room = min(self.count + max(FIRST, self.count // GROWTH), self.most // each)
        if room <= self.count:
            raise InputError(
                f"{self.path}: the first {self.count} frames already fill "
                f"{self.count * each / 2**30:.2g} GiB, and no more than {self.most / 2**30:.2g} "
                "are free for them; take fewer of them (`start`, `stop`, `stride`), or a clip "
                "with fewer pixels (`side`)"
            )
        self.frames.resize((room, *self.frames.shape[1:]), refcheck=False)


def free_memory() -> float:
    """Bytes that may still be asked for, of the machine or of the group that this runs in."""
    free = [_of_machine(), _of_group()]
    return min((each for each in free if each is not None), default=float(2 * MAX_BYTES))


def _of_machine() -> float | None:
    try:
        lines = FREE.read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    found = [line.split()[1] for line in lines if line.startswith("MemAvailable:")]
    return 1024 * float(found[0]) if found else None


def _of_group() -> float | None:
    try:
        limit, held, about = (
            (GROUP / f"memory.{name}").read_text(encoding="ascii")
            for name in ("max", "current", "stat")
        )
        cached = next(line.split()[1] for line in about.splitlines() if line.startswith("file "))
        return float(limit) - float(held) + float(cached)
    except (OSError, ValueError, StopIteration):  # no group, or one without a limit
        return None
