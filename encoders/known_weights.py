"""The weights that there are adapters for: where they come from and how they are known."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

SINGLE = (".safetensors", ".pt", ".pth")  # endings of weights that are one file


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
    """The table's entry.

    Raises:
        ValueError: unknown name.
    """
    if name not in KNOWN:
        raise ValueError(f"weights: unknown name {name!r}; known are {', '.join(KNOWN)}")
    return KNOWN[name]
