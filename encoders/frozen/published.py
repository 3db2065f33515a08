"""Weights that anyone may name: a folder, or a repository that lies in the hub's own cache."""

from __future__ import annotations

from pathlib import Path

from encoders.release import CONFIG, INDEX, TENSORS, WeightsFile, WeightsMissing, release_sha256

FRESH = "fresh weights"


def published(what: str, repository: str, where: Path | None) -> WeightsFile:
    """Find weights that no table pins; their hash goes into the features' identity.

    Args:
        what: that they are asked for, for messages.
        repository: on the hub, ``OWNER/NAME``; looked for in the hub's cache only.
        where: a release folder or one safetensors file instead.

    Raises:
        WeightsMissing: they are not on this machine, or not whole.
    """
    path = where
    if path is None:
        path = in_cache(repository)
    if path is None or not path.exists():
        place = "such a folder or in the hub's cache" if where is None else str(where)
        raise WeightsMissing(
            f"{what}: no weights in {place}; get them where there is a network by `hf download "
            f"{repository}`, or copy {CONFIG} and {TENSORS} into a folder and give it as `weights`"
        )
    return WeightsFile(path, release_sha256(path))


def fresh(seed: int) -> WeightsFile:
    """In place of trained weights, those of a seed: the control that shows what training adds."""
    return WeightsFile(Path(FRESH), f"{FRESH} {seed}")


def in_cache(repository: str) -> Path | None:
    """The newest snapshot of a repository in the hub's own cache; asks nobody."""
    from huggingface_hub import try_to_load_from_cache
    from huggingface_hub.errors import HFValidationError

    for file in (TENSORS, INDEX):
        try:
            found = try_to_load_from_cache(repository, file)
        except HFValidationError:  # no name of a repository: a folder that is not there
            return None
        if isinstance(found, str):
            return Path(found).parent
    return None
