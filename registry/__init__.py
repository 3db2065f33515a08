"""Parts under names: ours, those of installed packages, and those at an import path."""

from registry.lazy import lazily
from registry.registry import Registry, RegistryError, Source, UnknownName, unknown

__all__ = ["Registry", "RegistryError", "Source", "UnknownName", "lazily", "unknown"]
