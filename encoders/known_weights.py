"""The weights that there are adapters for: where they come from and how they are known."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

SINGLE = (".safetensors", ".pt", ".pth")  # endings of weights that are one file
PROCESSOR = ("preprocessor_config.json", "video_preprocessor_config.json")  # of transformers


@dataclass(frozen=True)
class WeightsEntry:
    """A set of weights.

    Args:
        file: name in the weights folder; a release folder where it has no ending of
            :data:`SINGLE`.
        sha256: the hashes of known releases; others are accepted once locked.
        licence: SPDX name.
        about: one line for people.
        hub: repository on the Hugging Face hub; ``None`` where no hub has them.
        revision: commit of the hub repository; ``None`` is resolved and locked by the first fetch.
        packaged: whether they are our own and lie in the package.
        url: of the file, where it is released elsewhere than on the hub.
        begins: first digits of the file's hash, which its publisher names it by.
        door: what opens them, ``timm:NAME``, ``hf`` or ``torchvision:NAME``; none where an encoder
            has an adapter of its own.
        config: of a model of transformers, what it is built from without its ``config.json``.
        look: how a model was shown its images, by :data:`encoders.preprocess.LOOKS`, where its
            release does not say it.
        beside: further files of the hub's repository, of which those that it has are fetched.
    """

    file: str
    sha256: tuple[str, ...]
    licence: str
    about: str
    hub: str | None = None
    revision: str | None = None
    packaged: bool = False
    url: str | None = None
    begins: str = ""
    door: str | None = None
    config: dict[str, Any] = field(default_factory=dict)
    look: str = "imagenet"
    beside: tuple[str, ...] = ()

    @property
    def is_folder(self) -> bool:
        """Whether the weights are a release folder."""
        return not self.file.endswith(SINGLE)

    def how_to_get(self, name: str) -> str:
        """What to do where the weights ``name`` are not here."""
        if self.packaged:
            return "installing vidphys again: they are a part of it"
        released = self.hub or self.url
        return f"`vidphys weights fetch {name}`" if released else "another way: no hub has them"

    def what_to_copy(self) -> str:
        """Which files to get on another machine, and from where."""
        if self.url is not None:
            return self.url
        if not self.is_folder:
            return f"model.safetensors of https://huggingface.co/{self.hub}"
        return (
            f"config.json and model.safetensors (or its index and shards) of "
            f"https://huggingface.co/{self.hub}"
        )


def _read() -> dict[str, WeightsEntry]:
    table = tomllib.loads(Path(__file__).with_name("weights.toml").read_text(encoding="utf-8"))
    return {
        name: WeightsEntry(**{"file": name, **row, "sha256": tuple(row.get("sha256", ()))})
        for name, row in table.items()
    }


KNOWN = _read()


def entry(name: str) -> WeightsEntry:
    """The table's entry, or what is behind a door: a release without a hash, locked when it comes.

    Args:
        name: a key of :data:`KNOWN`, ``timm:NAME``, ``hf:OWNER/NAME`` or ``torchvision:NAME``.

    Raises:
        ValueError: unknown name.
    """
    if name in KNOWN:
        return KNOWN[name]
    door, _, inner = name.partition(":")
    if inner and door in DOORS:
        return DOORS[door](inner)
    behind = ", ".join(f"{door}:NAME" for door in DOORS)
    raise ValueError(
        f"weights: unknown name {name!r}; known are {', '.join(KNOWN)}, and any {behind}"
    )


def timm_repository(name: str) -> str:
    """Where the hub has a network's weights, or those that its name without a tag means."""
    from timm.models import get_pretrained_cfg

    told = get_pretrained_cfg(name)
    return (told.hf_hub_id if told is not None else None) or f"timm/{name}"


def _of_timm(name: str) -> WeightsEntry:
    return _of_hub(timm_repository(name), f"timm--{name}", f"{name} of timm")


def _of_transformers(repository: str) -> WeightsEntry:
    file = f"hf--{repository.replace('/', '--')}"
    return _of_hub(repository, file, f"{repository} of transformers", PROCESSOR)


def _of_hub(repository: str, file: str, about: str, beside: tuple[str, ...] = ()) -> WeightsEntry:
    licence = f"that of https://huggingface.co/{repository}"
    return WeightsEntry(file, (), licence, about, repository, beside=beside)


def _of_torchvision(name: str) -> WeightsEntry:
    from torchvision.models import get_model_weights

    url = next(iter(get_model_weights(name))).url
    file = url.rpartition("/")[2]
    begins = file.rpartition("-")[2].partition(".")[0]
    licence = "that of https://docs.pytorch.org/vision"
    return WeightsEntry(file, (), licence, f"{name} of torchvision", url=url, begins=begins)


DOORS: dict[str, Callable[[str], WeightsEntry]] = {
    "timm": _of_timm,
    "hf": _of_transformers,
    "torchvision": _of_torchvision,
}
