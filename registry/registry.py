"""A table of parts by name, into which a part from outside comes as one of ours.

A name is looked up among the parts that code has registered, then among the entry points of
installed distributions, and at last, where it has a colon, behind a door of the registry's, such as
``timm:NAME``, or as an import path.
"""

from __future__ import annotations

import difflib
import hashlib
import importlib
import importlib.metadata
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar, overload

T = TypeVar("T")
HOME = "vidphys"  # the distribution that the stages themselves belong to


class RegistryError(ValueError):
    """A part cannot be had: no such name, two that give it, or an import that fails."""


class UnknownName(RegistryError, KeyError):
    """There is no part of this name; says which there are, and the nearest spelling."""

    def __str__(self) -> str:
        return str(self.args[0])


@dataclass(frozen=True)
class Source:
    """Where a part comes from: a distribution and its version, or a module and its file's hash."""

    distribution: str
    version: str

    @property
    def ours(self) -> bool:
        return self.distribution == HOME

    def __str__(self) -> str:
        return f"{self.distribution} {self.version}".strip()


class Registry(Mapping[str, T], Generic[T]):
    """Parts of one kind.

    Args:
        what: the kind, in the singular, for messages.
        group: of the entry points by which installed packages add parts.
        doors: by prefix, what makes a part of any name behind it: parts too many to be registered.

    Example:
        >>> greetings = Registry("greeting", "example.greetings")
        >>> @greetings.register("plain")
        ... def plain():
        ...     return "good day"
        >>> greetings["plain"]()
        'good day'
        >>> greetings["plane"]
        Traceback (most recent call last):
        registry.registry.UnknownName: unknown greeting 'plane'; did you mean 'plain'? Known: plain
    """

    def __init__(
        self, what: str, group: str, doors: Mapping[str, Callable[[str], T]] | None = None
    ) -> None:
        self.what, self.group, self.doors = what, group, dict(doors or {})
        self._parts: dict[str, T] = {}
        self._modules: dict[str, str] = {}

    @overload
    def register(self, name: str) -> Callable[[T], T]: ...
    @overload
    def register(self, name: str, part: T) -> T: ...

    def register(self, name: str, part: Any = None) -> Any:
        """Add a part, or decorate what is to be added.

        Raises:
            RegistryError: another part has this name.
        """
        module = sys._getframe(1).f_globals["__name__"]

        def add(part: T) -> T:
            if self._parts.get(name, part) is not part:
                raise RegistryError(
                    f"{self.what} '{name}': {module} would replace the one of "
                    f"{self._modules[name]}; choose another name"
                )
            self._parts[name] = part
            self._modules.setdefault(name, module)
            return part

        return add if part is None else add(part)

    def __getitem__(self, name: str) -> T:
        """The part of this name.

        Raises:
            UnknownName: there is none.
            RegistryError: two distributions have this name, or what it names cannot be imported.
        """
        entries = self._entries(name)
        if name not in self._parts:
            if entries:
                self._load(name, entries[0].value)
            elif ":" in name:
                self._open(name)
            else:
                raise unknown(self.what, name, self)
        strange = [entry for entry in entries if _top(entry.module) != _top(self._modules[name])]
        if strange or len(entries) > 1:
            givers = {str(self._giver(entry)) for entry in entries}
            givers |= {str(self._owner(self._modules[name]))}
            raise RegistryError(
                f"{self.what} '{name}': given by {' and by '.join(sorted(givers))}; "
                "uninstall one, or name it as package.module:attribute"
            )
        return self._parts[name]

    def __iter__(self) -> Iterator[str]:
        """Names: registered ones in their order, then those of installed packages."""
        return iter(dict.fromkeys([*self._parts, *sorted(self._installed.names)]))

    def __contains__(self, name: object) -> bool:
        return any(name == known for known in self)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def source(self, name: str) -> Source:
        """Where a part comes from.

        Raises:
            UnknownName: there is none of this name.
        """
        entries = self._entries(name)
        if entries and name not in self._modules:
            return self._giver(entries[0])
        self[name]
        return self._owner(self._modules[name])

    def name_of(self, part: Any) -> str:
        """The name of a part that a module defines; its import path where it has no other."""
        path = f"{part.__module__}:{part.__qualname__}"
        given = {entry.value: entry.name for entry in self._installed}
        known = {id(each): name for name, each in self._parts.items()}
        return given.get(path) or known.get(id(part), path)

    def ours(self) -> tuple[str, ...]:
        """Names of our own parts."""
        foreign = self.foreign()
        return tuple(name for name in self if ":" not in name and name not in foreign)

    def foreign(self) -> tuple[str, ...]:
        """Names of the parts of other packages, but for those asked for by an import path."""
        return tuple(name for name in self if ":" not in name and not self.source(name).ours)

    def home(self, name: str) -> Path:
        """The folder, or the one file, of the package that a part comes from.

        Raises:
            RegistryError: there is none of this name, or it cannot be imported.
        """
        self[name]
        file = Path(str(sys.modules[_top(self._modules[name])].__file__)).resolve()
        return file.parent if file.name == "__init__.py" else file

    def sources(self, *names: str) -> dict[str, str]:
        """Where those of these parts come from that are not ours, for a record."""
        found = {f"{self.what} {name}": self.source(name) for name in names}
        return {name: str(source) for name, source in found.items() if not source.ours}

    @cached_property
    def _installed(self) -> importlib.metadata.EntryPoints:
        """Of installed packages; read once, for it takes milliseconds."""
        return importlib.metadata.entry_points(group=self.group)

    @cached_property
    def _own(self) -> Collection[str]:
        """Our own top-level packages: most parts are of these, and they are quickly known."""
        try:
            told = importlib.metadata.distribution(HOME).read_text("top_level.txt")
        except importlib.metadata.PackageNotFoundError:
            return ()
        return (told or "").split()

    @cached_property
    def _owners(self) -> Mapping[str, list[str]]:
        """Distributions by top-level package; read once, for it takes a tenth of a second."""
        return importlib.metadata.packages_distributions()

    def _giver(self, entry: importlib.metadata.EntryPoint) -> Source:
        if entry.dist is None:
            return self._owner(entry.module)
        return Source(entry.dist.name, entry.dist.version)

    def _owner(self, module: str) -> Source:
        """The distribution whose top-level package a module lies in; else the module itself."""
        names = [HOME] if _top(module) in self._own else self._owners.get(_top(module), ())
        if not names:
            file = getattr(sys.modules.get(module), "__file__", None)
            code = hashlib.sha256(Path(file).read_bytes()).hexdigest()[:12] if file else ""
            return Source(module, code)
        return Source(names[0], importlib.metadata.version(names[0]))

    @cached_property
    def _by_name(self) -> Mapping[str, list[importlib.metadata.EntryPoint]]:
        """Those of a name: a clip of a data set asks twenty times."""
        found: dict[str, list[importlib.metadata.EntryPoint]] = {}
        for entry in self._installed:
            found.setdefault(entry.name, []).append(entry)
        return found

    def _entries(self, name: str) -> list[importlib.metadata.EntryPoint]:
        return self._by_name.get(name, [])

    def _open(self, name: str) -> None:
        prefix, _, rest = name.partition(":")
        if prefix not in self.doors:
            self._load(name, name)
            return
        self._parts[name] = self.doors[prefix](rest)
        self._modules[name] = self.doors[prefix].__module__

    def _load(self, name: str, path: str) -> None:
        module, _, attribute = path.partition(":")
        try:
            part: Any = importlib.import_module(module)
            for step in attribute.split("."):
                part = getattr(part, step)
        except (ImportError, AttributeError) as error:
            raise RegistryError(
                f"{self.what} '{name}': {path} cannot be imported: {error}"
            ) from error
        self._parts.setdefault(name, part)
        self._modules.setdefault(name, module)


def unknown(what: str, name: str, known: Iterable[str]) -> UnknownName:
    """What to raise where a name is none of the known ones."""
    names = list(known)
    near = difflib.get_close_matches(name, names, n=1)
    hint = f"; did you mean '{near[0]}'?" if near else ";"
    return UnknownName(f"unknown {what} '{name}'{hint} Known: {', '.join(names)}")


def _top(module: str) -> str:
    return module.partition(".")[0]
