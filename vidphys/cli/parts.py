"""``vidphys parts``: every part by name, ours and those of installed packages."""

from __future__ import annotations

import importlib
from dataclasses import dataclass

REGISTRIES = {
    "scenes": ("vidphys.scenes", "SCENES"),
    "formats": ("vidphys.data.formats", "FORMATS"),
    "sets": ("vidphys.data.sets", "SETS"),
    "encoders": ("encoders.frozen", "ENCODERS"),
    "binders": ("binders", "BINDERS"),
    "readouts": ("readouts", "READOUTS"),
    "targets": ("vidphys.probing.catalogue", "TARGETS"),
    "terms": ("dynamics.terms", "TERMS"),
    "heads": ("dynamics", "HEADS"),
    "rungs": ("vidphys.perception.catalogue", "RUNGS"),
    "tables": ("vidphys.experiments.catalogue", "TABLES"),
}


@dataclass(frozen=True)
class PartsConfig:
    """List every part by name; those of other packages with their distribution and version.

    Example: vidphys parts

    A part of a module that is installed nowhere is named as package.module:attribute.
    """


def parts(_config: PartsConfig) -> None:
    """Print a line for each kind, and one for each part that is not ours."""
    for kind, (module, attribute) in REGISTRIES.items():
        registry = getattr(importlib.import_module(module), attribute)
        print(f"{kind:<10}{', '.join(registry.ours())}")
        for prefix in registry.doors:
            print(f"{'':<10}{prefix}:NAME, any of that library's")
        for name in registry.foreign():
            print(f"{'':<10}{name} ({registry.source(name)})")
