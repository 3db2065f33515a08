"""What the site tells of the code is read from it: every verb's help, the records' columns."""

from __future__ import annotations

import importlib
from dataclasses import fields
from typing import Any

VERBS_HERE, COLUMNS_HERE = "<!-- every verb -->", "<!-- the records' columns -->"
WIDTH = 100  # of the help


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Fill in what a page leaves to the code."""
    if VERBS_HERE in markdown:
        markdown = markdown.replace(VERBS_HERE, _verbs())
    if COLUMNS_HERE in markdown:
        markdown = markdown.replace(COLUMNS_HERE, _columns())
    return markdown


def _verbs() -> str:
    from vidphys.cli import VERBS
    from vidphys.cli.helped import helped

    parts = []
    for verb, (name, about) in VERBS.items():
        config = getattr(importlib.import_module(f"vidphys.cli.{verb}"), name)
        parts.append(f"## {verb}\n\n{about}\n\n```text\n{helped(verb, config, WIDTH)}\n```\n")
    return "\n".join(parts)


def _columns() -> str:
    from vidphys.runs.records import RECORD_SCHEMA, Origin

    whose = {field.name for field in fields(Origin)}
    says = {True: "whose number it is", False: "the number, and how it came about"}
    rows = [f"| `{x.name}` | {x.type} | {says[x.name in whose]} |" for x in RECORD_SCHEMA]
    return "\n".join(["| column | type | says |", "|---|---|---|", *rows])
