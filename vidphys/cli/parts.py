"""``vidphys parts``: every part by name, ours and those of installed packages."""

from __future__ import annotations

import importlib
import json
from dataclasses import dataclass
from typing import Any

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

    Args:
        json: print them as JSON, for a script.
    """

    json: bool = False


def parts(config: PartsConfig) -> None:
    """Print a line for each kind, and one for each part that is not ours."""
    known = {kind: _known(*where) for kind, where in REGISTRIES.items()}
    if config.json:
        print(json.dumps(known))
        return
    for kind, held in known.items():
        print(f"{kind:<10}{', '.join(held['ours'])}")
        for prefix in held["doors"]:
            print(f"{'':<10}{prefix}:NAME, any of that library's")
        for name, source in held["others"].items():
            print(f"{'':<10}{name} ({source})")


def _known(module: str, attribute: str) -> dict[str, Any]:
    registry = getattr(importlib.import_module(module), attribute)
    others = {name: str(registry.source(name)) for name in registry.foreign()}
    return {"ours": list(registry.ours()), "doors": list(registry.doors), "others": others}
