"""Independent seeds from one number and a few names, so that no two streams share a state."""

from __future__ import annotations

import hashlib


def derive(seed: int, *names: str) -> int:
    """A 63-bit seed that depends on ``seed`` and every name.

    Example:
        >>> derive(0, "init") == derive(0, "init"), derive(0, "init") == derive(1, "init")
        (True, False)
    """
    text = "/".join([str(seed), *names])
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 1
