"""The Hugging Face hub: what lies in its own cache on this machine, and files from it."""

from __future__ import annotations

from pathlib import Path


def in_cache(repository: str, *files: str, revision: str | None = None) -> Path | None:
    """The folder of a snapshot in the hub's own cache; asks nobody.

    Args:
        repository: ``OWNER/NAME``.
        files: of which the snapshot has one.
        revision: commit; the newest where not given.
    """
    from huggingface_hub import try_to_load_from_cache
    from huggingface_hub.errors import HFValidationError

    for file in files:
        try:
            found = try_to_load_from_cache(repository, file, revision=revision)
        except HFValidationError:  # no name of a repository: a folder that is not there
            return None
        if isinstance(found, str):
            return Path(found).parent
    return None


def from_hub(repository: str, file: str, revision: str | None) -> tuple[Path, str]:
    """A file, downloaded into the hub's own cache where it is not there, and the commit it is of.

    What was downloaded in part is continued.

    Raises:
        FileNotFoundError: the repository has no such file.
        ConnectionError: the hub did not give it.
    """
    from huggingface_hub import HfApi, hf_hub_download
    from huggingface_hub.errors import RemoteEntryNotFoundError

    # the client raises errors of several libraries; all mean that the hub gave no file
    try:
        commit = revision or HfApi().model_info(repository).sha
        return Path(hf_hub_download(repository, file, revision=commit)), str(commit)
    except RemoteEntryNotFoundError as error:
        raise FileNotFoundError(f"{repository} has no {file}") from error
    except Exception as error:
        reason = str(error).strip().split("\n")[0] or type(error).__name__
        raise ConnectionError(f"{repository}/{file}: {reason}") from error
