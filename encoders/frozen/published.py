"""Weights that anyone may name: a folder, or a repository that lies in the hub's own cache."""

from __future__ import annotations

from pathlib import Path

from encoders.hub import in_cache
from encoders.known_weights import entry
from encoders.release import CONFIG, INDEX, TENSORS, WeightsFile, WeightsMissing, release_sha256
from encoders.weights import find_weights, weights_path


def published(what: str, repository: str, where: Path | None) -> WeightsFile:
    """Find weights that no table pins; their hash goes into the features' identity.

    Args:
        what: that they are asked for, for messages.
        repository: on the hub, ``OWNER/NAME``; looked for where they are fetched to, then in the
            hub's own cache.
        where: a weights folder, or a release folder or one safetensors file.

    Raises:
        WeightsMissing: they are not on this machine, or not whole.
        ValueError: they were fetched, and are not any more what came.
    """
    fetched = weights_path(what, where)
    if fetched != where and fetched.exists():
        return find_weights(what, where)
    path = in_cache(repository, TENSORS, INDEX) if where is None else where
    if path is None or not path.exists():
        place = "such a folder or in the hub's cache" if where is None else str(where)
        raise WeightsMissing(
            f"{what}: no weights in {place}; get them by `vidphys weights fetch {what}`, or copy "
            f"{entry(what).what_to_copy()} into a folder and give it as `weights`"
        )
    return WeightsFile(path, release_sha256(path))


def configuration(what: str, repository: str, where: Path | None) -> Path:
    """The folder with the ``config.json`` of a repository, its weights there or not.

    Args:
        what, repository, where: see :func:`published`.

    Raises:
        WeightsMissing: it is not on this machine.
    """
    fetched = weights_path(what, where)
    if fetched != where and fetched.exists():
        return fetched
    folder = in_cache(repository, CONFIG) if where is None else where
    if folder is None or not (folder / CONFIG).is_file():
        raise WeightsMissing(
            f"{what}: weights of a seed need no file but {CONFIG}, which is not here; get it where "
            f"there is a network by `hf download {repository} {CONFIG}`, or give its folder as "
            "`weights`"
        )
    return folder
