"""``vidphys store``: what a feature store holds; pack, check, thin out and copy it."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from encoders.store import FeatureStore
from vidphys.errors import InputError

if TYPE_CHECKING:
    from encoders.remote import Remote

COLUMNS = ("encoder", "layer", "entries", "bytes")


@dataclass(frozen=True)
class StoreConfig:
    """List, pack, check, thin out or copy a feature store.

    Example: vidphys store list features

    Args:
        action: list what is there by encoder and layer; pack entries that are files of their own
            into shards, which also brings older stores to the present layout; check all hashes;
            delete what an encoder made, or one entry, so that the next extraction makes it again;
            push to a URL what is not there yet, or pull from it what is not here.
        folder: the store's.
        encoder: with delete: whose entries.
        layer: with delete: of this layer only.
        key: with delete: this entry only, as a check names it.
        url: with push and pull: a folder of an object store (s3://bucket/features, for which the
            extra s3 is installed), or any other that fsspec knows.
        json: with list: print it as JSON, for a script.
    """

    action: Annotated[
        Literal["list", "pack", "check", "delete", "push", "pull"], tyro.conf.Positional
    ]
    folder: Annotated[Path, tyro.conf.Positional]
    encoder: str | None = None
    layer: str | None = None
    key: str | None = None
    url: str | None = None
    json: bool = False


def store(config: StoreConfig) -> int:
    """Do what ``config.action`` says; returns 1 where a check finds damaged entries, else 0.

    Raises:
        InputError: no store there, an encoder to delete that is not named, or a damaged entry.
    """
    if (config.url is not None) != (config.action in ("push", "pull")):
        raise InputError("store: --url goes with push and pull, which need it")
    if config.json and config.action != "list":
        raise InputError("store: --json goes with list only")
    if config.action != "pull" and not any(
        (config.folder / part).is_dir() for part in ("entries", "shards")
    ):
        raise InputError(f"store: {config.folder} is no feature store; `vidphys extract` makes one")
    asked = (config.encoder is not None) + (config.key is not None)
    if asked != (config.action == "delete"):
        raise InputError("store: --encoder or --key goes with delete, which needs one of them")
    kept = FeatureStore(config.folder)
    try:
        return _ACTIONS[config.action](kept, config)
    except ValueError as error:
        raise InputError(str(error)) from error


def _list(kept: FeatureStore, config: StoreConfig) -> int:
    counts: Counter[tuple[str, str]] = Counter()
    sizes: Counter[tuple[str, str]] = Counter()
    for name, layer, count, size in kept.counts():
        counts[name, layer] += count
        sizes[name, layer] += size
    held = [(*which, counts[which], sizes[which]) for which in sorted(counts)]
    if config.json:
        print(json.dumps([dict(zip(COLUMNS, row, strict=True)) for row in held]))
        return 0
    for name, layer, count, size in held:
        print(f"{name}, layer {layer}: {count} entries, {size / 2**20:.3g} MiB")
    return 0


def _pack(kept: FeatureStore, config: StoreConfig) -> int:
    print(f"{kept.pack()} entries of {config.folder} were put into shards")
    return 0


def _check(kept: FeatureStore, config: StoreConfig) -> int:
    bad = kept.verify()
    for key in bad:
        print(f"{key}: damaged")
    todo = (
        "; `vidphys store delete` takes one out by its --key, to be extracted again" if bad else ""
    )
    print(f"{config.folder}: {len(bad)} entries are damaged{todo}")
    return 1 if bad else 0


def _delete(kept: FeatureStore, config: StoreConfig) -> int:
    if config.key is not None:
        if not kept.drop(config.key):
            raise InputError(f"store: no entry {config.key}; `vidphys store check` names keys")
        print(f"entry {config.key} was deleted")
        return 0
    assert config.encoder is not None
    count = kept.delete(config.encoder, config.layer)
    print(f"{count} entries of {config.encoder} were deleted")
    return 0


def _push(kept: FeatureStore, config: StoreConfig) -> int:
    copied = _remote(config).push(kept)
    print(f"{copied / 2**20:.3g} MiB of {config.folder} were copied to {config.url}")
    return 0


def _pull(kept: FeatureStore, config: StoreConfig) -> int:
    copied = _remote(config).pull(kept)
    print(f"{copied / 2**20:.3g} MiB of {config.url} were copied to {config.folder}")
    return 0


def _remote(config: StoreConfig) -> Remote:
    from encoders.remote import Remote

    assert config.url is not None
    return Remote(config.url)


_ACTIONS = {
    "list": _list,
    "pack": _pack,
    "check": _check,
    "delete": _delete,
    "push": _push,
    "pull": _pull,
}
