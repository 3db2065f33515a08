"""How much memory is free for the frames of a clip."""

from __future__ import annotations

from pathlib import Path

from vidphys.errors import InputError

MAX_BYTES = 8 * 2**30
SHARE = 0.5  # of the memory that is free
FREE, GROUP = Path("/proc/meminfo"), Path("/sys/fs/cgroup")


def require_memory(size: int) -> None:
    """Refuse to hold so many bytes of frames.

    Raises:
        InputError: more than is free for them.
    """
    most = min(MAX_BYTES, int(SHARE * free_memory()))
    if size > most:
        raise InputError(
            f"all frames at once fill {size / 2**30:.2g} GiB, and no more than {most / 2**30:.2g} "
            "are free for them; take fewer of them (`start`, `stop`, `stride`), or a clip with "
            "fewer pixels (`side`)"
        )


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
