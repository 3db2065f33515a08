"""Which code is running: its version, and a hash of what could have made a number."""

from __future__ import annotations

import ast
import hashlib
import importlib.metadata
import subprocess
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cache, partial
from pathlib import Path
from types import FunctionType, MethodType
from typing import Any

SOURCE = Path(__file__).resolve().parents[2]
STAGES = ("loops", "registry", "dynamics", "encoders", "renderers", "binders", "readouts")
OWN = (*STAGES, "vidphys")
ASIDE = ("cli", "stress", "testing", "trade")  # rooms of vidphys that no table's number is made in
# What only names parts (one that is used is found on what uses it), judges numbers or draws them.
NO_MAKERS = (
    "vidphys",
    "vidphys.perception.catalogue",
    "vidphys.experiments.catalogue",
    "vidphys.experiments.core.bars",
    "vidphys.experiments.core.figures",
    "vidphys.experiments.core.showcase",
)


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
def code_hash(modules: tuple[str, ...] = (), source: Path = SOURCE) -> str:
    """The first 16 digits of the SHA-256 over the sources that could have made a number.

    Args:
        modules: that define what made it; they count with all of ours that they import, also
            inside functions and by way of others. Where none is named, all that any table's
            number is made in counts: a number is rather called stale in vain than kept in error.
        source: folder of the packages.
    """
    files = _closure(modules, source) if modules else _everything(source)
    digest = hashlib.sha256()
    for file in sorted(files):
        text = file.read_bytes() if file.is_file() else b"gone"
        digest.update(file.relative_to(source).as_posix().encode() + b"\0" + text)
    return digest.hexdigest()[:16]


def modules_of(*parts: object) -> tuple[str, ...]:
    """Our modules that define some parts, and what these hold: fields, items, bound arguments.

    Example:
        >>> from vidphys.scenes import gravity
        >>> modules_of(partial(gravity, "gaussian"))
        ('vidphys.scenes.gravity',)
    """
    found, seen, left = set(), set(), list(parts)
    while left:
        part = left.pop()
        if id(part) not in seen:
            seen.add(id(part))
            found.add((part if isinstance(part, type | FunctionType) else type(part)).__module__)
            left += _held(part)
    return tuple(sorted(name for name in found if name.partition(".")[0] in OWN))


def _held(part: Any) -> list[object]:
    if isinstance(part, partial):
        return [part.func, *part.args, *part.keywords.values()]
    if isinstance(part, MethodType):
        return [part.__self__, part.__func__]
    if isinstance(part, FunctionType):
        closed = [cell.cell_contents for cell in part.__closure__ or ()]
        return [*closed, *(part.__defaults__ or ())]
    if isinstance(part, Mapping):
        return [*part.values()]
    if isinstance(part, list | tuple | set | frozenset):
        return [*part]
    if is_dataclass(part) and not isinstance(part, type):
        return [getattr(part, field.name) for field in fields(part)]
    return []


def _everything(source: Path) -> set[Path]:
    files = {file for name in STAGES for file in (source / name).rglob("*.py")}
    own = (source / "vidphys").rglob("*.py")
    return files | {file for file in own if file.relative_to(source).parts[1] not in ASIDE}


def _closure(modules: Iterable[str], source: Path) -> set[Path]:
    """Files of some modules and of all of ours that they import."""
    found: dict[str, Path] = {}
    left = [*modules]
    while left:
        name = left.pop()
        if name not in found and name not in NO_MAKERS:
            found[name] = _file(name, source) or source / f"{name}.py"
            left += _imported(name, source)
    return set(found.values())


@cache
def _imported(name: str, source: Path) -> frozenset[str]:
    """Our modules that one imports, with the packages that they lie in."""
    file = _file(name, source)
    if file is None:
        return frozenset()
    named = set(_named(ast.parse(file.read_bytes()).body)) | {name}
    parents = {each[:at] for each in named for at, c in enumerate(each) if c == "."}
    return frozenset(each for each in named | parents if _file(each, source))


def _named(body: Iterable[ast.AST]) -> Iterator[str]:
    """Modules, and attributes that may be modules, which statements import; not for types only.

    So do texts: the homes of what a package hands on lazily.
    """
    for node in body:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            yield from _named(node.orelse)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Constant):
            if isinstance(node.value, str) and node.value.replace(".", "").isidentifier():
                yield node.value
        else:
            yield from _named(ast.iter_child_nodes(node))


@cache
def _file(name: str, source: Path) -> Path | None:
    """Where one of our modules lies; ``None`` if it is none."""
    if name.partition(".")[0] not in OWN:
        return None
    plain = source.joinpath(*name.split("."))
    for file in (plain.with_suffix(".py"), plain / "__init__.py"):
        if file.is_file():
            return file
    return None
