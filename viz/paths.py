"""Places on the machine that a run was made on, as somebody elsewhere may read them."""

from __future__ import annotations

import re
from pathlib import Path

SHOWN = 2  # parts of a path that are kept
LONG = re.compile(r"(?<![\w:/.~…])/(?:[^\s/'\":;,()<>]+/){2,}[^\s/'\":;,()<>]*")


def without_folders(value: object) -> str:
    """Text in which of each long absolute path only the end is left.

    Example:
        >>> without_folders("no folder /home/me/project/weights/hiera; get it")
        'no folder …/weights/hiera; get it'
    """

    def short(found: re.Match[str]) -> str:
        return "…/" + "/".join(found[0].strip("/").split("/")[-SHOWN:])

    return LONG.sub(short, str(value))


def typed(path: Path) -> str:
    """A path as it would be typed: from the folder where somebody stands, or by its name."""
    whole = path.resolve()
    if whole.is_relative_to(Path.cwd()):
        return str(whole.relative_to(Path.cwd()))
    return whole.name
