"""One HTML page that needs nothing else: its style, and figures turned into inline text."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from viz.whole import whole

CSS = Path(__file__).with_name("page.css").read_text(encoding="utf-8")


def page(title: str, body: str) -> str:
    """The whole document."""
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{CSS}</style>\n</head>\n"
        f"<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def read_verdicts(run: Path) -> tuple[Any, Any]:
    """What ``run.json`` and ``verdicts.json`` of a run folder hold.

    Raises:
        ValueError: one of the two is missing or cannot be read.
    """
    try:
        return tuple(
            json.loads((run / name).read_text(encoding="utf-8"))
            for name in ("run.json", "verdicts.json")
        )
    except (OSError, ValueError) as error:
        raise ValueError(f"report: {run} cannot be read: {error}") from error


def heading(title: str, lead: str) -> str:
    """The title of a page, and what it is about in a sentence or two of HTML."""
    return f'<h1>{escape(title)}</h1>\n<p class="lead">{lead}</p>'


def write_page(run: Path, title: str, head: str, sections: Sequence[str]) -> Path:
    """Write ``report.html`` of a run folder, all of it or nothing.

    Args:
        run: the folder.
        title: in the browser's tab, before the folder's name.
        head: see :func:`heading`.
        sections: see :func:`section`; links to them stand before them.
    """
    body = "\n".join([head, contents(sections), *sections])
    path = run / "report.html"
    with whole(path) as part:
        part.write_text(page(f"{title} · {run.resolve().name}", body), encoding="utf-8")
    return path


def section(name: str, title: str, *parts: str) -> str:
    """A headed part of the page that links can point at."""
    return f'<section id="{name}">\n<h2>{escape(title)}</h2>\n' + "\n".join(parts) + "\n</section>"


def contents(sections: Sequence[str]) -> str:
    """Links to the sections."""
    found = [re.search(r'id="(\w+)">\n<h2>(.*?)</h2>', part) for part in sections]
    links = "".join(f'<a href="#{m[1]}">{m[2]}</a>' for m in found if m)
    return f"<nav>{links}</nav>"


def paragraph(text: str) -> str:
    """Text as a paragraph."""
    return f"<p>{escape(text)}</p>"


def inline_svg(svg: str, label: str, caption: str) -> str:
    """A figure as vectors inside the page."""
    drawing = svg[svg.index("<svg") :]
    drawing = re.sub(r"<metadata>.*?</metadata>", "", drawing, flags=re.DOTALL)
    drawing = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", drawing)  # implied within HTML
    drawing = re.sub(r'(<svg[^>]*?)\sheight="[^"]*"', r"\1", drawing, count=1)
    drawing = re.sub(r'(<svg[^>]*?)\swidth="[^"]*"', r"\1", drawing, count=1)
    drawing = drawing.replace("<svg", f'<svg role="img" aria-label="{escape(label)}"', 1)
    return _figure(drawing, caption)


def inline_png(png: bytes, label: str, caption: str) -> str:
    """A picture inside the page."""
    data = base64.b64encode(png).decode("ascii")
    image = f'<img alt="{escape(label)}" src="data:image/png;base64,{data}">'
    return _figure(image, caption)


def _figure(content: str, caption: str) -> str:
    note = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f'<figure><div class="scroll">{content}</div>{note}</figure>'
