"""One HTML page that needs nothing else: its style, and figures turned into inline text."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

CSS = """
:root { --ink:#1d2329; --dim:#5d6873; --line:#dde2e7; --soft:#f5f7f9; --good:#00664b; --bad:#a33a00;
  --accent:#0072b2; color-scheme: light; }
* { box-sizing: border-box; }
body { margin:0; background:#fff; color:var(--ink); font:16px/1.55 system-ui, -apple-system,
  "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
main { max-width:1260px; margin:0 auto; padding:2rem 1.25rem 4rem; }
h1 { font-size:1.9rem; line-height:1.2; margin:0 0 .3rem; letter-spacing:-.01em; }
h2 { font-size:1.3rem; margin:2.8rem 0 .6rem; padding-top:.9rem; border-top:1px solid var(--line); }
h3 { font-size:1rem; margin:1.4rem 0 .3rem; }
p, li { max-width:48rem; }
.lead { color:var(--dim); margin:0 0 1.4rem; }
nav { display:flex; flex-wrap:wrap; gap:.2rem 1.1rem; margin:1.2rem 0 0; font-size:.9rem; }
a { color:var(--accent); }
dl.facts { display:grid; grid-template-columns:repeat(auto-fill, minmax(11rem, 1fr));
  gap:.7rem 1.4rem; margin:0; padding:1rem 1.1rem; background:var(--soft); border-radius:8px; }
dl.facts dt { color:var(--dim); font-size:.76rem; letter-spacing:.02em; }
dl.facts dd { margin:0; font-weight:600; overflow-wrap:anywhere; }
.tally { display:flex; flex-wrap:wrap; gap:.5rem; padding:0; margin:1rem 0; list-style:none; }
.callout { border-left:4px solid var(--bad); background:#fdf5f0; padding:.7rem 1.1rem;
  border-radius:0 8px 8px 0; }
.callout.calm { border-color:var(--good); background:#f0f8f5; }
.callout > :first-child { margin-top:0; } .callout > :last-child { margin-bottom:0; }
.callout li { max-width:none; margin:.25rem 0; }
.scroll { overflow-x:auto; margin:.8rem 0 1.2rem; border:1px solid var(--line); border-radius:8px; }
table { border-collapse:collapse; font-size:.85rem; line-height:1.35; width:100%; }
th, td { padding:.45rem .6rem; text-align:left; vertical-align:top; border-top:1px solid #edf0f2; }
thead th, thead td { border-top:0; background:var(--soft); color:var(--dim); font-weight:600;
  vertical-align:bottom; }
thead tr + tr > * { padding-top:0; }
th[scope=colgroup] { border-left:1px solid var(--line); color:var(--ink); white-space:nowrap; }
tr.first > * { border-top:1px solid #c8d0d7; }
th[scope=rowgroup] { white-space:nowrap; background:#fff; position:sticky; left:0; }
th.head { font-weight:500; white-space:nowrap; }
th.head i { display:inline-block; width:.65em; height:.65em; border-radius:2px;
  margin-right:.45em; }
td.num { font-variant-numeric:tabular-nums; white-space:nowrap; }
td.num b, td.num span { white-space:nowrap; }
td.said { min-width:16rem; }
td.none { color:var(--dim); }
td small { display:block; color:var(--dim); white-space:nowrap; }
.chip { display:inline-block; padding:0 .5em; border-radius:99px; font-size:.78rem; font-weight:600;
  line-height:1.6; border:1px solid; }
td .chip { margin-top:.15rem; }
td.num .chip { display:block; width:fit-content; }
th small { display:block; color:var(--dim); font-weight:500; }
.chip.good { color:var(--good); border-color:#9fd0c1; background:#eef8f4; }
.chip.bad { color:var(--bad); border-color:#e9bd9f; background:#fdf3ec; }
.chip.dull { color:var(--dim); border-color:var(--line); background:var(--soft); }
figure { margin:1rem 0; } figure .scroll { border:0; margin:0; }
figure svg, figure img { display:block; width:100%; min-width:40rem; height:auto; }
figcaption, .note { color:var(--dim); font-size:.88rem; max-width:48rem; margin-top:.4rem; }
details { margin:.6rem 0; } summary { cursor:pointer; font-weight:600; }
code, pre { font:.86em ui-monospace, SFMono-Regular, Menlo, Consolas, monospace; }
code { overflow-wrap:anywhere; }
@media (max-width:40rem) { main { padding:1.2rem .9rem 3rem; } h1 { font-size:1.5rem; }
  th, td { padding:.4rem .5rem; } th[scope=rowgroup] { white-space:normal; } }
@media print { @page { size:A4 landscape; margin:12mm; } body { font-size:9.5pt; }
  main { max-width:none; padding:0; } nav { display:none; } .scroll { overflow:visible; border:0; }
  figure svg, figure img { min-width:0; } figure, tr { break-inside:avoid; }
  h2 { break-after:avoid; } table { font-size:7.5pt; } th, td { padding:.25rem .35rem; }
  .chip, .callout, dl.facts, thead th { print-color-adjust:exact; } }
"""


def page(title: str, body: str) -> str:
    """The whole document."""
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{CSS}</style>\n</head>\n"
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
    part = path.with_name(".report.html.part")
    part.write_text(page(f"{title} · {run.resolve().name}", body), encoding="utf-8")
    part.replace(path)
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
