"""Seeds: independent ones from one number and a few names, and what each number is for."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable

DEVELOPMENT, CONFIRMATION = "development", "confirmation"
ROLES = (CONFIRMATION, DEVELOPMENT)  # as they are shown
UNSEEN_FROM = 100  # no one looks at these seeds while tuning


def role_of(seed: int) -> str:
    """What a seed is for: those that were looked at while tuning confirm nothing.

    Example:
        >>> [role_of(seed) for seed in (0, 2, 100)]
        ['development', 'development', 'confirmation']
    """
    return CONFIRMATION if seed >= UNSEEN_FROM else DEVELOPMENT


def of_roles(seeds: Iterable[int]) -> dict[str, list[int]]:
    """Seeds by role, ascending; confirmation first.

    Example:
        >>> of_roles([1, 100, 0])
        {'confirmation': [100], 'development': [0, 1]}
    """
    every = sorted(seeds)
    found = {role: [seed for seed in every if role_of(seed) == role] for role in ROLES}
    return {role: each for role, each in found.items() if each}


def told(seeds: Iterable[int]) -> str:
    """Seeds in words, each group with what it is for.

    Example:
        >>> told([0, 1, 100])
        '100 (confirmation); 0, 1 (development)'
    """
    groups = of_roles(seeds).items()
    return "; ".join(f"{', '.join(map(str, each))} ({role})" for role, each in groups)


def derive(seed: int, *names: str) -> int:
    """A 63-bit seed that depends on ``seed`` and every name.

    Example:
        >>> derive(0, "init") == derive(0, "init"), derive(0, "init") == derive(1, "init")
        (True, False)
    """
    text = "/".join([str(seed), *names])
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 1
