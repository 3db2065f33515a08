"""Peak memory of a call, and keeping freed memory in the process.

A large tensor is fresh memory each time, and its page faults can cost more than what is computed in
it: several times on the processors that this was seen on. A comparison that does not say which of
the two was measured says little; :func:`keep_memory` makes them equal.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

STATUS, RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")
M_TRIM_THRESHOLD, M_MMAP_MAX = -1, -4  # of malloc.h


def peak_bytes(work: Callable[[], Any], device: str) -> tuple[Any, int | None]:
    """What one call returns, and the most memory that it holds above what is held before it.

    On a CPU it is the resident memory of the process, as Linux counts it, after what was freed
    has been handed back; ``None`` where that is not to be had.
    """
    if device == "cuda":
        torch.cuda.reset_peak_memory_stats()
        before = torch.cuda.memory_allocated()
        result = work()
        torch.cuda.synchronize()
        return result, torch.cuda.max_memory_allocated() - before
    libc = _libc()
    if libc is not None:
        libc.malloc_trim(0)
    try:
        RESET.write_text("5", encoding="ascii")
        before = _resident("VmRSS")
    except OSError:
        return work(), None
    result = work()
    return result, max(0, _resident("VmHWM") - before)


def keep_memory() -> bool:
    """From now on let freed memory stay in the process, so that no call pays for fresh pages.

    Returns:
        Whether this C library can do it; elsewhere nothing is changed.
    """
    libc = _libc()
    if libc is None:
        return False
    return bool(libc.mallopt(M_MMAP_MAX, 0)) and bool(libc.mallopt(M_TRIM_THRESHOLD, 2**31 - 1))


def _libc() -> Any:
    try:
        libc = ctypes.CDLL(None)
        return libc if hasattr(libc, "mallopt") and hasattr(libc, "malloc_trim") else None
    except OSError:
        return None


def _resident(field: str) -> int:
    for line in STATUS.read_text(encoding="ascii").splitlines():
        if line.startswith(f"{field}:"):
            return 1024 * int(line.split()[1])
    raise OSError(f"no {field} in {STATUS}")
