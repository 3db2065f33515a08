"""One table cell at a time: a number from the records, or the word that stands for it.

Templates draw them (``templates/macros.html``); nothing here knows of HTML.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from viz.summary import GATED, SKILL_BAR, Summary, one_sided_p

Choice = Callable[[Sequence[float]], float | None]
Mark = tuple[str, str]  # a word, and its tone: good, bad or dull


@dataclass(frozen=True)
class Cell:
    """What stands in one cell.

    Args:
        text: the number or the words.
        value: the exact number, by which a table is sorted.
        small: notes below it.
        marks: words in colour.
        kind: ``num`` for numbers, ``said`` for sentences, ``none`` where nothing was measured.
    """

    text: str = ""
    value: float | None = None
    small: tuple[str, ...] = ()
    marks: tuple[Mark, ...] = ()
    kind: str = "num"


NOT_MEASURED = Cell("–", kind="none")


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


def said(text: str) -> Cell:
    """Plain words."""
    return Cell(text or "–", kind="said")


def mean_cell(found: Summary | None, *marks: Mark) -> Cell:
    """Mean with its interval, and what happened to the seeds that do not count."""
    if found is None:
        return NOT_MEASURED
    small: tuple[str, ...] = ()
    if found.interval is not None:
        low, high, kind = found.interval
        ends = (number(low), number(high))
        small = (f"[{ends[0]}, {ends[1]}]" if kind == "95 %" else f"range {ends[0]} to {ends[1]}",)
    shown = "" if found.mean is None else number(found.mean)
    return Cell(shown, found.mean, small, (*_lost(found), *marks))


def chosen_cell(found: Summary | None, choose: Choice) -> Cell:
    """One value chosen over the seeds, for example their median or the largest."""
    if found is None:
        return NOT_MEASURED
    value = choose(found.values) if found.values else None
    return Cell("" if value is None else number(value), value, (), _lost(found))


def match_cell(plain: Summary | None, gated: Summary | None = None) -> Cell:
    """Seeds whose rollout is nearer to the changed law's truth, with the exact test if all are."""
    if plain is None:
        return NOT_MEASURED
    shown, small = "", []
    marks = list(_lost(plain))
    if plain.values:
        hits, total = int(sum(plain.values)), len(plain.values)
        shown = f"{hits}/{total}"
        if hits == total:
            small.append(f"p = {number(one_sided_p(hits, total))}")
    if gated is not None and gated.values:
        small.append(f"gated {int(sum(gated.values))}/{len(gated.values)}")
    if gated is not None and plain.values:
        marks += [(gated.words, "dull")] if gated.bad else []
    return Cell(shown, plain.mean, tuple(small), tuple(marks))


def skill_cell(found: Summary | None) -> Cell:
    """Error over the zero-force predictor's, marked by whether it counts as inversion."""
    if found is None or not found.values:
        return mean_cell(found)
    below, total = sum(value < SKILL_BAR for value in found.values), len(found.values)
    word = f"< {SKILL_BAR:g} on {below}/{total}"
    return mean_cell(found, (word, "good" if below == total else "bad"))


def nonfinite_cell(found: Summary | None) -> Cell:
    """Non-finite episodes of all episodes, over the seeds."""
    if found is None or not found.episodes:
        return NOT_MEASURED
    shown, value = f"{found.nonfinite}/{found.episodes}", float(found.nonfinite)
    return Cell("", value, (), ((shown, "bad"),)) if found.nonfinite else Cell(shown, value)


def _lost(found: Summary) -> tuple[Mark, ...]:
    """The seeds that do not count; that a gate was not passed is no failure."""
    tone = "dull" if found.metric == GATED else "bad"
    return ((found.words, tone),) if found.words else ()
