"""One HTML page that needs nothing else: templates filled in, figures as inline text."""

from __future__ import annotations

import base64
import io
import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from viz import kept
from viz.cells import number
from viz.paths import without_folders
from viz.svg import compact
from viz.whole import whole

COLOURS = 256  # of an inline picture


@dataclass(frozen=True)
class Drawn:
    """A figure of a page.

    Args:
        content: an ``svg`` or an ``img``.
        caption: below it.
    """

    content: Markup
    caption: str = ""


@cache
def templates() -> jinja2.Environment:
    """What lies in ``templates/``; what is not there is an error, and text is escaped."""
    made = jinja2.Environment(
        loader=jinja2.PackageLoader("viz"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters |= {"number": number, "pathless": without_folders, "embedded": embedded}
    return made


def embedded(data: Any) -> Markup:
    """Data as JSON that may stand in a script of a page."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c"))


def render(template: str, told: dict[str, Any]) -> str:
    """A page as text.

    Args:
        template: its name in ``templates/``.
        told: what it says.
    """
    return templates().get_template(template).render(told)


def write_page(run: Path, template: str, told: dict[str, Any], name: str = "report.html") -> Path:
    """Write a page into a run folder, all of it or nothing.

    Args:
        run: the folder.
        template: its name in ``templates/``.
        told: what it says; the folder's name is added as ``folder``.
        name: of the file.
    """
    path = run / name
    text = render(template, {"folder": run.resolve().name, **told})
    with whole(path) as part:
        part.write_text(text, encoding="utf-8")
    return path


def read_verdicts(run: Path) -> tuple[Any, Any]:
    """What ``run.json`` and ``verdicts.json`` of a run folder hold.

    Raises:
        ValueError: one of the two is missing or cannot be read.
    """
    try:
        about, verdicts = (kept.words(run / name) for name in ("run.json", "verdicts.json"))
        verdicts.pop("schema_version", None)
        return about, verdicts
    except ValueError as error:
        raise ValueError(f"report: {run} cannot be read: {error}") from error


def inline_svg(svg: str, label: str, caption: str = "") -> Drawn:
    """A figure as vectors inside the page."""
    named = Markup('<svg role="img" aria-label="{}"').format(label)
    return Drawn(Markup(compact(svg).replace("<svg", named, 1)), caption)


def inline_png(png: bytes, label: str, caption: str = "") -> Drawn:
    """A picture inside the page, of as many colours as are told apart in one."""
    from PIL import Image

    small = io.BytesIO()
    Image.open(io.BytesIO(png)).convert("RGB").quantize(COLOURS).save(small, "PNG", optimize=True)
    data = base64.b64encode(small.getvalue()).decode("ascii")
    image = Markup('<img alt="{}" src="data:image/png;base64,{}">').format(label, data)
    return Drawn(image, caption)
