"""Whose the installed packages are: names and files that another distribution may have taken."""

from __future__ import annotations

import base64
import hashlib
import importlib.metadata
from collections.abc import Iterable
from importlib.metadata import Distribution, PackagePath
from pathlib import Path

OURS = "vidphys"


def changed(names: Iterable[str] | None = None) -> list[str]:
    """Files of the installation that are not those that were installed, or are gone.

    Args:
        names: of packages, of which only the first file is looked at; all files by default.
    """
    try:
        files = importlib.metadata.distribution(OURS).files or []
    except importlib.metadata.PackageNotFoundError:  # a checkout on the path
        return []
    first = None if names is None else {f"{name}/__init__.py" for name in names}
    listed = (file for file in files if first is None or str(file) in first)
    return sorted(str(file) for file in listed if not _is_as_installed(file))


def others(names: Iterable[str]) -> dict[str, list[str]]:
    """By package, the other distributions that install one of its name; only where there are."""
    wanted, found = set(names), dict[str, list[str]]()
    for distribution in importlib.metadata.distributions():
        if distribution.name == OURS:
            continue
        for name in wanted & _packages(distribution):
            found.setdefault(name, []).append(distribution.name)
    return {name: sorted(set(who)) for name, who in sorted(found.items())}


def _packages(distribution: Distribution) -> set[str]:
    """Top-level names that a distribution installs."""
    said = distribution.read_text("top_level.txt")
    if said is not None:
        return set(said.split())
    return {file.parts[0] for file in distribution.files or () if len(file.parts) > 1}


def _is_as_installed(file: PackagePath) -> bool:
    if file.hash is None:  # RECORD itself, and what was compiled since
        return True
    path = Path(str(file.locate()))
    if not path.is_file():
        return False
    digest = hashlib.new(file.hash.mode, path.read_bytes()).digest()
    return base64.urlsafe_b64encode(digest).rstrip(b"=").decode() == file.hash.value
