"""One table cell at a time, as HTML: a number from the records, or the word that stands for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from html import escape

from viz.summary import SKILL_BAR, Summary, one_sided_p

NOT_MEASURED = '<td class="num none" title="not measured">–</td>'
Choice = Callable[[Sequence[float]], float | None]


def number(value: float) -> str:
    """Three significant digits, five close below 1; an exponent where zeros would pile up."""
    if value == 0:
        return "0"
    if not 1e-3 <= abs(value) < 1e4:
        mantissa, exponent = f"{value:.2e}".split("e")
        return f"{mantissa}e{int(exponent)}"
    if 0.9 <= abs(value) < 1:
        return f"{value:.5g}"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def chip(word: str, tone: str) -> str:
    """A small labelled mark; ``tone`` is good, bad or dull."""
    return f'<span class="chip {tone}">{escape(word)}</span>'


def tally(marks: Iterable[tuple[str, str]]) -> str:
    """A row of chips, each a word and its tone."""
    items = "".join(f"<li>{chip(word, tone)}</li>" for word, tone in marks)
    return f'<ul class="tally">{items}</ul>'


def numeric(value: float | None, text: str) -> str:
    """A cell that shows ``text`` and keeps the exact value beside it."""
    exact = "" if value is None else f' data-value="{value!r}" title="{value:.6g}"'
    return f'<td class="num"{exact}>{text}</td>'


def mean_cell(found: Summary | None, extra: str = "") -> str:
    """Mean with its interval, and what happened to the seeds that do not count."""
    if found is None:
        return NOT_MEASURED
    parts = []
    if found.mean is not None:
        parts.append(f"<b>{number(found.mean)}</b>")
    if found.interval is not None:
        low, high, kind = found.interval
        ends = (number(low), number(high))
        shown = f"[{ends[0]}, {ends[1]}]" if kind == "95 %" else f"range {ends[0]} to {ends[1]}"
        parts.append(f"<small>{shown}</small>")
    if found.words:
        parts.append(chip(found.words, "bad"))
    return numeric(found.mean, "".join(parts) + extra)


def chosen_cell(found: Summary | None, choose: Choice) -> str:
    """One value chosen over the seeds, for example their median or the largest."""
    if found is None:
        return NOT_MEASURED
    value = choose(found.values) if found.values else None
    text = "" if value is None else f"<b>{number(value)}</b>"
    return numeric(value, text + (chip(found.words, "bad") if found.words else ""))


def match_cell(plain: Summary | None, gated: Summary | None = None) -> str:
    """Seeds whose rollout is nearer to the changed law's truth, with the exact test if all are."""
    if plain is None:
        return NOT_MEASURED
    parts = []
    if plain.values:
        hits, total = int(sum(plain.values)), len(plain.values)
        parts.append(f"<b>{hits}/{total}</b>")
        if hits == total:
            parts.append(f"<small>p = {number(one_sided_p(hits, total))}</small>")
    if gated is not None and gated.values:
        parts.append(f"<small>gated {int(sum(gated.values))}/{len(gated.values)}</small>")
    if plain.words:
        parts.append(chip(plain.words, "bad"))
    return numeric(plain.mean, "".join(parts))


def skill_cell(found: Summary | None) -> str:
    """Error over the zero-force predictor's, marked by whether it counts as inversion."""
    if found is None or not found.values:
        return mean_cell(found)
    below, total = sum(value < SKILL_BAR for value in found.values), len(found.values)
    word = f"< {SKILL_BAR:g} on {below}/{total}"
    return mean_cell(found, chip(word, "good" if below == total else "bad"))


def nonfinite_cell(found: Summary | None) -> str:
    """Non-finite episodes of all episodes, over the seeds."""
    if found is None or not found.episodes:
        return NOT_MEASURED
    text = f"{found.nonfinite}/{found.episodes}"
    return numeric(float(found.nonfinite), chip(text, "bad") if found.nonfinite else text)
