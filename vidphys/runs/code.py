"""Which code is running: its version, and a hash of what computes numbers."""

from __future__ import annotations

import hashlib
import importlib.metadata
import subprocess
from functools import cache
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[2]
COMPUTING = ("loops", "registry", "dynamics", "encoders", "renderers", "binders", "readouts")
ASIDE = ("cli", "stress", "testing", "trade")  # rooms of vidphys that no table's number is made in


def code_version() -> str:
    """The commit of a source checkout (with ``+dirty`` for local changes), else the version."""
    if not (SOURCE / ".git").exists():
        return importlib.metadata.version("vidphys")
    try:
        command = ["git", "-C", str(SOURCE), "describe", "--always", "--dirty=+dirty"]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return importlib.metadata.version("vidphys")


@cache
def code_hash() -> str:
    """The first 16 digits of the SHA-256 over the sources that a table's numbers come from.

    All of them, whatever the table: a number is rather called stale in vain than kept in error.
    """
    files = [file for name in COMPUTING for file in (SOURCE / name).rglob("*.py")]
    own = (SOURCE / "vidphys").rglob("*.py")
    files += [file for file in own if file.relative_to(SOURCE).parts[1] not in ASIDE]
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(file.relative_to(SOURCE).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]
