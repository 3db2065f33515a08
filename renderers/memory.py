"""Whether an image will fit, asked before it is allocated."""

from __future__ import annotations

from pathlib import Path

import torch

SMALL = 2**24  # numbers: less is never asked about
COPIES = 3  # of the result, while it is made
MEMINFO = Path("/proc/meminfo")


def check_fits(who: str, shape: tuple[int, ...], dtype: torch.dtype, device: torch.device) -> None:
    """Refuse a result that is larger than the memory that is free.

    Raises:
        ValueError: it does not fit; what it needs and what there is are said.
    """
    numbers = torch.Size(shape).numel()
    if numbers < SMALL or torch.compiler.is_compiling():
        return
    needed, free = COPIES * numbers * dtype.itemsize, _free(device)
    if free is not None and needed > free:
        raise ValueError(
            f"{who}: images of shape {shape} need about {needed / 2**30:.1f} GiB, of which "
            f"{free / 2**30:.1f} are free; render fewer or smaller ones at a time"
        )


def _free(device: torch.device) -> int | None:
    """Bytes; ``None`` where the system does not say."""
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    if not MEMINFO.exists():
        return None
    for line in MEMINFO.read_text(encoding="ascii").splitlines():
        if line.startswith("MemAvailable:"):
            return 1024 * int(line.split()[1])
    return None
