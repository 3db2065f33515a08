"""``vidphys weights``: which weights there are, get them, check them."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import tyro

from encoders.known_weights import KNOWN, entry
from encoders.release import WeightsMissing
from encoders.weights import fetch, find_weights, lock, weights_path
from vidphys.errors import InputError


@dataclass(frozen=True)
class WeightsConfig:
    """List, fetch or check the weights of frozen encoders.

    Example: vidphys weights fetch hiera --weights weights

    Args:
        action: list what is known and whether it is here; fetch from the hub; check the hashes.
        names: encoders, or any timm:NAME, hf:OWNER/NAME or torchvision:NAME; for list and check all
            that have a name, if none is named.
        weights: folder; else VIDPHYS_WEIGHTS, else the user's cache.
        lock: with check: accept the files as they are and write their hashes beside them.
        json: with list: print it as JSON, for a script.
    """

    action: Annotated[Literal["list", "fetch", "check"], tyro.conf.Positional]
    names: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    weights: Path | None = None
    lock: bool = False
    json: bool = False


def weights(config: WeightsConfig) -> None:
    """Do what ``config.action`` says and print a line for each encoder.

    Raises:
        InputError: unknown names, nothing to fetch, a hub that cannot be reached, a named file
            that is missing, or one with a wrong hash.
    """
    if config.lock and config.action != "check":
        raise InputError("weights: --lock goes with check only")
    if config.json and config.action != "list":
        raise InputError("weights: --json goes with list only")
    if config.action == "fetch" and not config.names:
        raise InputError(
            f"weights fetch: name what to fetch; known are {', '.join(KNOWN)}, "
            "and any timm:NAME, hf:OWNER/NAME or torchvision:NAME"
        )
    try:
        for name in config.names or KNOWN:
            entry(name)
        if config.json:
            print(json.dumps([_told(name, config) for name in config.names or KNOWN]))
            return
        for name in config.names or KNOWN:
            print(_ACTIONS[config.action](name, config))
    except ValueError as error:
        raise InputError(str(error)) from error


def _told(name: str, config: WeightsConfig) -> dict[str, str | None]:
    known, path = entry(name), weights_path(name, config.weights)
    return {
        "name": name,
        "about": known.about,
        "licence": known.licence,
        "path": str(path) if path.exists() else None,
        "get it by": known.how_to_get(name),
    }


def _list(name: str, config: WeightsConfig) -> str:
    told = _told(name, config)
    where = told["path"] or f"not here, get it by {told['get it by']}"
    return f"{name}: {told['about']}; {told['licence']}; {where}"


def _fetch(name: str, config: WeightsConfig) -> str:
    known, shown = entry(name), sys.stderr.isatty()
    try:
        found = fetch(name, config.weights, partial(_show, name) if shown else None)
    except ConnectionError as error:
        raise InputError(
            f"weights fetch {name}: the hub did not give it ({error}); get it elsewhere: copy "
            f"{known.what_to_copy()} to {weights_path(name, config.weights)} and run "
            f"`vidphys weights check {name} --lock`"
        ) from error
    return f"{name}: {found.path}, sha256 {found.sha256}; licence: {known.licence}"


def _show(name: str, done: int, whole: int) -> None:
    end = "\n" if done == whole else ""
    print(f"\r{name}: {done / 2**20:.0f} of {whole / 2**20:.0f} MiB", end=end, file=sys.stderr)


def _check(name: str, config: WeightsConfig) -> str:
    path = weights_path(name, config.weights)
    # those of the package are pinned by the table, and no place to write to
    if config.lock and path.exists() and not entry(name).packaged:
        return f"{name}: {path} locked, sha256 {lock(path, None)}"
    try:
        found = find_weights(name, config.weights)
    except WeightsMissing:
        if config.names:
            raise
        return f"{name}: not here"
    return f"{name}: {found.path} is as expected, sha256 {found.sha256}"


_ACTIONS = {"list": _list, "fetch": _fetch, "check": _check}
