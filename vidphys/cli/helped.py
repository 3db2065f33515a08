"""What ``vidphys help VERB`` prints: what it does, an example, its options in groups."""

from __future__ import annotations

import inspect
import re
import shutil
import textwrap
import types
from dataclasses import MISSING, Field, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import tyro

from vidphys.cli.seeing import SeeingOptions

ASKED, ENCODER = "What is asked", "The encoder"
GROUPS = {  # an option that stands in none is one of what is asked
    "What is read": (
        *("columns", "interval", "angles", "start", "stop", "stride", "side", "rate", "resample"),
        *("scale", "gravity", "hold_out", "train_share", "split_by"),
    ),
    "Which bodies": (
        *("at", "region", "colour", "size", "mask", "choose", "binder", "bodies", "shadow"),
    ),
    ENCODER: ("encoders", "weights", "layers", "runtime", "fast"),
    "Sizes and steps": (
        *("steps", "batch", "learning_rates", "widths", "rates", "readers", "mirrors", "patience"),
        *("shift", "head_steps", "friction", "on_nan"),
    ),
    "Where it is computed": ("device", "workers", "engine", "address", "threads", "measured"),
    "What is kept and shown": (
        *("out", "store", "store_dtype", "grid", "profile", "overwrite", "json", "quiet"),
    ),
}
ORDER = (ASKED, *GROUPS)
KINDS = {int: "N", float: "NUMBER", Path: "PATH", str: "TEXT"}
MOST, INDENT = 100, 26  # columns of a page, and of the names


@dataclass(frozen=True)
class Option:
    """One line of the help: how it is written, what it says, and its group; "" is positional."""

    written: str
    text: str
    group: str


def helped(verb: str, config: type, width: int | None = None) -> str:
    """The help of a verb, as text.

    Args:
        verb: its name.
        config: its configuration, a dataclass whose docstring says what each argument is.
        width: columns; those of the terminal, at most 100, unless given.
    """
    width = width or min(MOST, shutil.get_terminal_size().columns)
    options = options_of(config)
    places = [option for option in options if not option.group]
    usage = " ".join(["usage: vidphys", verb, *(x.written for x in places), "[options]"])
    about = re.split(r"\n(?:Args|Raises):\n", inspect.cleandoc(config.__doc__ or ""))[0].strip()
    parts = [usage, *(_wrapped(part, width) for part in about.split("\n\n")), _lines(places, width)]
    for group in ORDER:
        found = [option for option in options if option.group == group]
        if found:
            parts.append(f"{group}:\n{_lines(found, width)}")
    return "\n\n".join(part for part in parts if part)


def options_of(config: type) -> list[Option]:
    """Each option of a verb's configuration."""
    hints = get_type_hints(config, include_extras=True)
    said: dict[str, str] = {}
    owner: dict[str, type] = {}
    for part in reversed(config.__mro__):
        told = _told(part)
        said |= told
        owner |= dict.fromkeys(vars(part).get("__annotations__", {}), part)
    return [
        _option(field, hints[field.name], said[field.name], owner[field.name])
        for field in fields(config)
    ]


def _told(part: type) -> dict[str, str]:
    """What the docstring of a class says of each of its arguments."""
    section = re.search(r"^Args:\n((?: {4}.*\n?|\n)*)", inspect.cleandoc(part.__doc__ or ""), re.M)
    pattern = r"^ {4}(\w[\w, ]*): (.*\n?(?: {8}.*\n?)*)"
    found = re.findall(pattern, section[1], re.M) if section else ()
    return {name: " ".join(text.split()) for names, text in found for name in names.split(", ")}


def _option(field: Field[Any], hint: Any, text: str, owner: type) -> Option:
    marks, hint = (hint.__metadata__, hint.__origin__) if _is(hint, Annotated) else ((), hint)
    default = None if field.default is MISSING else field.default
    kind = _kind(hint)
    shown = " ".join(map(str, default)) if isinstance(default, tuple) else default
    if hint is not bool and default not in (None, (), ""):
        text = f"{text.removesuffix('.')} (default: {shown})."
    if tyro.conf.Positional in marks:
        name = kind if kind.startswith("{") else field.name.upper()
        name += " ..." if get_origin(hint) is tuple else ""
        return Option(name if field.default is MISSING else f"[{name}]", text, "")
    names = [
        _flag(field.name),
        *(x for mark in marks for x in getattr(mark, "aliases", None) or ()),
    ]
    if hint is bool and default:
        names, text = [f"--no-{field.name}"], f"do not {text}"
    elif field.default is MISSING:
        text = f"{text.removesuffix('.')} (needed)."
    written = ", ".join(names) + (f" {kind}" if kind else "")
    return Option(written, text, _group(field.name, owner))


def _group(name: str, owner: type) -> str:
    for title, names in GROUPS.items():
        if name in names:
            return title
    return ENCODER if owner is SeeingOptions else ASKED


def _kind(hint: Any) -> str:
    """What stands for the value of an option; nothing for one that is given or not."""
    if _is(hint, Literal):
        return "{" + ",".join(map(str, get_args(hint))) + "}"
    if get_origin(hint) is tuple:
        return f"{_kind(get_args(hint)[0])} ..."
    if get_origin(hint) in (Union, types.UnionType):
        several = [_kind(part) for part in get_args(hint) if part is not type(None)]
        return "|".join(several)
    return KINDS.get(hint, "")


def _is(hint: Any, kind: Any) -> bool:
    return get_origin(hint) is kind


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _wrapped(text: str, width: int) -> str:
    return textwrap.fill(" ".join(text.split()), width, break_on_hyphens=False)


def _lines(options: list[Option], width: int) -> str:
    lines = []
    for option in options:
        head = f"  {option.written}"
        beside = len(head) < INDENT - 1
        body = textwrap.wrap(option.text, width - INDENT, break_on_hyphens=False)
        if not beside:
            lines.append(head)
        first = head if beside else ""
        lines += [(first if k == 0 else "").ljust(INDENT) + line for k, line in enumerate(body)]
    return "\n".join(lines)
