"""``vidphys completion``: what a shell needs to complete verbs and options."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from functools import reduce
from operator import or_
from typing import Annotated, Any, Literal

import tyro


@dataclass(frozen=True)
class CompletionConfig:
    """Print a script by which the shell completes verbs, options and their values.

    Example: source <(vidphys completion bash)

    Args:
        shell: the one that you type into.
    """

    shell: Annotated[Literal["bash", "zsh", "tcsh"], tyro.conf.Positional] = "bash"


def completion(config: CompletionConfig) -> int:
    """See :class:`CompletionConfig`."""
    from vidphys.cli import VERBS

    verbs: list[Any] = [
        Annotated[
            getattr(importlib.import_module(f"vidphys.cli.{verb}"), name),
            tyro.conf.subcommand(name=verb),
        ]
        for verb, (name, _) in VERBS.items()
    ]
    try:
        tyro.cli(reduce(or_, verbs), prog="vidphys", args=["--tyro-print-completion", config.shell])
    except SystemExit as ended:  # which is how tyro ends when it has printed it
        return int(ended.code or 0)
    return 1
