"""``--profile FILE`` of every verb: settings that `vidphys trade --pick` chose on this machine."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Protocol, TypeVar


class _Profiled(Protocol):
    @property
    def profile(self) -> Path | None: ...


Config = TypeVar("Config", bound=_Profiled)


def with_profile(config: Config, verb: str) -> Config:
    """A verb's configuration as its profile sets it; one line where it sets nothing of it.

    Raises:
        InputError: see :func:`vidphys.trade.profile.under_profile`.
    """
    path = config.profile
    if path is None:
        return config
    from vidphys.trade.profile import TAKES, read_profile, under_profile

    if verb in TAKES:
        return under_profile(config, path, verb)
    fronts = sorted({point.front for point in read_profile(path).points})
    print(
        f"{verb}: --profile {path} sets nothing here (it has {', '.join(fronts) or 'no points'}; "
        f"it sets options of {', '.join(TAKES)})",
        file=sys.stderr,
    )
    return config
