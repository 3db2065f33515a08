"""What verbs that share options do with them: refuse those without effect, make the binder."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vidphys.cli.who import WhoOptions
from vidphys.errors import InputError

if TYPE_CHECKING:
    from binders.base import Binder

MOTION = "motion"  # the binder unless another is named


def option(name: str) -> str:
    """As it is written on the command line."""
    return f"--{name.replace('_', '-')}"


def refuse(config: Any, names: Iterable[str], why: str) -> None:
    """Refuse options that were given and would have no effect; none are ``None``, () or False.

    Raises:
        InputError: one was given.
    """
    for name in names:
        if getattr(config, name) not in (None, (), False):
            raise InputError(f"{option(name)}: would have no effect: {why}; leave it away")


def require_file(path: Path, instead: str) -> None:
    """Refuse a file that is not there, with the nearest name that is.

    Raises:
        InputError: no such file, or a folder.
    """
    if path.is_file():
        return
    if path.is_dir():
        raise InputError(f"{path}: a folder, of no kind that is known; {instead}")
    beside = path.parent.iterdir() if path.parent.is_dir() else ()
    near = difflib.get_close_matches(path.name, [each.name for each in beside], 1)
    also = f"did you mean {path.with_name(near[0])}?" if near else instead
    raise InputError(f"{path}: no such file; {also}")


def given_columns(columns: Iterable[str]) -> dict[str, str]:
    """What ``--columns`` says: the name of a table's column, by the role that it has.

    Raises:
        InputError: not ROLE=NAME.
    """
    pairs = {}
    for text in columns:
        role, sign, name = text.partition("=")
        if not (role and sign and name):
            raise InputError(f"--columns {text}: write ROLE=NAME, for example x=PosX or time[ms]=T")
        pairs[role] = name
    return pairs


def make_binder(
    name: str | None,
    bodies: int | None,
    shadow: float | None,
    who: WhoOptions | None = None,
    count: bool = False,
) -> Binder:
    """The binder of a name, told what was given.

    Args:
        name: of the binder; the hand-made one where not given.
        bodies, shadow, who: what it is told.
        count: let the hand-made one count the bodies, where their number is not given.

    Raises:
        InputError: an unknown name, numbers that make no sense, or one that it does not take.
    """
    from binders import BINDERS

    name = name or MOTION
    try:
        factory = BINDERS[name]
    except ValueError as error:
        raise InputError(f"--binder {name}: {error}") from error
    given: dict[str, Any] = {"bodies": 1 if bodies is None else bodies} | (
        {} if shadow is None else {"shadow": shadow}
    )
    if who is not None and who.given:
        given = given | {"wanted": who.wanted()}
        count = count or bool(who.at or who.choose)
    if bodies is None and count and name == MOTION:
        given = given | {"bodies": None}
    for each in given:
        if each not in inspect.signature(factory).parameters:
            told = option(who.given[0]) if who is not None and each == "wanted" else f"--{each}"
            raise InputError(f"{told}: would have no effect: --binder {name} takes none")
    try:
        return factory(**given)
    except ValueError as error:
        raise InputError(f"--{error}") from error
