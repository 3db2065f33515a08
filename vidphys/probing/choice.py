"""What an atlas says: for each target, which encoder at which layer, and how sure that is.

Layers are compared on the same clips, drawn anew together. Where one was chosen for being the best
of several, the choice is made again in every draw, so that the interval knows of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from vidphys.points.pareto import pareto
from vidphys.points.point import CPU_CLOCK, Point
from vidphys.probing.atlas import CHANCE, COST, ERROR, FORM, SCORE, SELECTIVITY
from vidphys.probing.controls import CONTROLS
from vidphys.probing.scores import LEVEL, Bootstrap, Score, Sums

FROM, TO = 1 / 3, 2 / 3  # relative depth of what counts as the middle
SHOWN, REFUTED, OPEN = "shown", "refuted", "not decided"


@dataclass(frozen=True)
class Place:
    """One layer of one encoder, asked for one target.

    Args:
        encoder, layer, depth, target: where; depth is 0 at the first layer and 1 at the last.
        score, selectivity: means over seeds of values and of both ends of the intervals.
        controls: scores of the controls.
        cost: ms a clip: median and quartiles.
        sums: errors of each clip, means over seeds.
        form: of the features that the readout took in most folds.
    """

    encoder: str
    layer: str
    depth: float
    target: str
    score: Score
    selectivity: Score
    controls: Mapping[str, float]
    cost: Score
    sums: Sums
    form: str

    @property
    def rival(self) -> str:
        """The best control of those that a score has to beat."""
        rivals = [name for name in self.controls if CONTROLS[name].rival]
        return max(rivals, key=lambda name: self.controls[name])

    @property
    def sure(self) -> bool:
        """Whether it is surely above chance, and above the best rival."""
        return self.score.low > 0 and self.selectivity.low > 0

    @property
    def name(self) -> str:
        """In words."""
        return f"{self.encoder} at layer {self.layer}"


@dataclass(frozen=True)
class Choice:
    """For one target, the best layer of all encoders, and the cheapest that is hardly worse.

    Layers that are surely above their controls go before all others.

    Args:
        target: what was asked.
        encoder, layer, form: that knows most of it, and how it is read there.
        score, selectivity: of these.
        rival, rival_score: the best control.
        ms_per_clip: its cost.
        cheaper: the cheapest layer that is not surely worse, where it is another: encoder, layer,
            score and cost.
        front: encoder and layer of what no other is both cheaper and better than.
        sentence: all of it in words.
    """

    target: str
    encoder: str
    layer: str
    form: str
    score: Score
    selectivity: Score
    rival: str
    rival_score: float
    ms_per_clip: float
    cheaper: tuple[str, str, float, float] | None
    front: tuple[tuple[str, str], ...]
    sentence: str


@dataclass(frozen=True)
class Depth:
    """Whether a target is known in the middle of an encoder, and neither before nor after.

    Args:
        target, encoder: of which.
        difference: the best score in the middle third less the best outside of it.
        verdict: refuted where a layer outside of the middle surely knows it, above every rival;
            shown where none does, and the middle does and is surely better; else not decided.
        sentence: in words.
    """

    target: str
    encoder: str
    difference: Score
    verdict: str
    sentence: str


def places_of(
    records: Sequence[Mapping[str, Any]], episodes: Sequence[Mapping[str, Any]]
) -> list[Place]:
    """Every layer and target of a run, from its tables."""
    numbers: dict[tuple[str, str], list[float]] = {}
    for row in records:
        if row["value"] is not None:
            numbers.setdefault((row["cell"], row["metric"]), []).append(row["value"])
    clips: dict[tuple[str, str], dict[int, list[float]]] = {}
    for row in episodes:
        each = clips.setdefault((row["cell"], row["metric"]), {})
        each.setdefault(row["episode"], []).append(row["value"])
    encoders = {row["cell"]: row["encoder"] for row in records}
    return [
        _place(cell, encoders[cell], numbers, clips) for cell, metric in numbers if metric == SCORE
    ]


def _place(
    cell: str,
    encoder: str,
    numbers: Mapping[tuple[str, str], list[float]],
    clips: Mapping[tuple[str, str], dict[int, list[float]]],
) -> Place:
    layer, _, target = cell.removeprefix(f"{encoder}/").partition("/")

    def score(name: str, of: str = cell) -> Score:
        return Score(*(float(np.mean(numbers[of, name + end])) for end in ("", "_low", "_high")))

    def sums(name: str) -> np.ndarray:
        each = clips[cell, name]
        return np.array([np.mean(each[clip]) for clip in sorted(each)])

    def named(start: str) -> dict[str, list[float]]:
        return {
            metric.removeprefix(start): values
            for (of, metric), values in numbers.items()
            if of == cell and metric.startswith(start)
        }

    controls = {n: float(np.mean(v)) for n, v in named("control/").items() if n in CONTROLS}
    forms = named(FORM)  # one that no fold of a seed took has no number there
    return Place(
        encoder,
        layer,
        float(numbers[cell, "depth"][0]),
        target,
        score(SCORE),
        score(SELECTIVITY),
        controls,
        score(COST, f"{encoder}/{layer}"),
        Sums(sums(ERROR), sums(CHANCE)),
        max(forms, key=lambda name: sum(forms[name])),
    )


def choices_of(places: Sequence[Place]) -> list[Choice]:
    """A choice for each target, in the order in which they were asked."""
    targets = dict.fromkeys(place.target for place in places)
    return [_choice([p for p in places if p.target == target]) for target in targets]


def _choice(places: Sequence[Place]) -> Choice:
    # a layer that random weights or pixels equal is no reason to pass over one that they do not
    sure = [place for place in places if place.sure]
    best = max(sure or places, key=lambda place: place.score.value)
    draws = Bootstrap(len(best.sums.error))
    level = [
        place
        for place in places
        if place is best or draws.difference(best.sums, place.sums).low <= 0
    ]
    cheap = min(level, key=lambda place: place.cost.value)
    cheaper = None if cheap is best else cheap
    about = cheap.encoder, cheap.layer, cheap.score.value, cheap.cost.value
    return Choice(
        best.target,
        best.encoder,
        best.layer,
        best.form,
        best.score,
        best.selectivity,
        best.rival,
        best.controls[best.rival],
        best.cost.value,
        None if cheaper is None else about,
        _front(places),
        _sentence(best, cheaper),
    )


def _sentence(best: Place, cheaper: Place | None) -> str:
    evidence = (
        f"read by {best.form}, score {best.score}, best control {best.rival} "
        f"{best.controls[best.rival]:.2f}, selectivity {best.selectivity}, "
        f"{best.cost.value:.3g} ms a clip"
    )
    if not best.sure:
        return (
            f"for {best.target} nothing here is surely above its controls; the highest score is "
            f"that of {best.name} ({evidence})"
        )
    more = ""
    if cheaper is not None:
        more = (
            f"; {cheaper.name} is not surely worse ({cheaper.score.value:.2f}) at "
            f"{cheaper.cost.value:.3g} ms a clip"
        )
    return f"for {best.target} take {best.name} ({evidence}){more}"


def _front(places: Sequence[Place]) -> tuple[tuple[str, str], ...]:
    front = pareto([_point(place) for place in places])
    return tuple((str(p.configuration["encoder"]), str(p.configuration["layer"])) for p in front)


def _point(place: Place) -> Point:
    """A place as the measured point that it is."""
    return Point(
        front="atlas",
        task=place.target,
        configuration={"encoder": place.encoder, "layer": place.layer},
        cost_name=COST,
        cost=place.cost.value,
        cost_low=place.cost.low,
        cost_high=place.cost.high,
        clock=CPU_CLOCK,
        wall=place.cost.value,
        repeats=3,
        warmup_seconds=0.0,
        peak_bytes=None,
        error_name="one_minus_score",
        error=1 - place.score.value,
        reference="labels",
        seed=0,
        device="cpu",
        dtype="float32",
        threads=1,
    )


def depths_of(places: Sequence[Place]) -> list[Depth]:
    """For each target and encoder with a middle, whether it is known there alone."""
    found = []
    for target in dict.fromkeys(place.target for place in places):
        for encoder in dict.fromkeys(place.encoder for place in places):
            mine = [p for p in places if (p.target, p.encoder) == (target, encoder)]
            inside = [p for p in mine if FROM <= p.depth <= TO]
            outside = [p for p in mine if p not in inside]
            if inside and outside:
                found.append(_depth(inside, outside))
    return found


def _depth(inside: Sequence[Place], outside: Sequence[Place]) -> Depth:
    draws = Bootstrap(len(inside[0].sums.error))
    middle, rest = (
        np.max([draws.draws(place.sums) for place in some], 0) for some in (inside, outside)
    )
    best = max(inside, key=lambda p: p.score.value)
    known = [p for p in outside if p.sure]
    other = max(known or outside, key=lambda p: p.score.value)
    low, high = np.percentile(middle - rest, [(100 - LEVEL) / 2, (100 + LEVEL) / 2])
    most = max(p.score.value for p in outside)
    difference = Score(best.score.value - most, float(low), float(high))
    verdict = REFUTED if known else SHOWN if low > 0 and best.sure else OPEN
    sentence = (
        f"{best.target} in the middle of {best.encoder} alone: {verdict} (layer {best.layer} "
        f"{best.score.value:.2f}, selectivity {best.selectivity}; elsewhere layer {other.layer} "
        f"{other.score.value:.2f}, selectivity {other.selectivity}; difference {difference})"
    )
    return Depth(best.target, best.encoder, difference, verdict, sentence)


def told(places: Sequence[Place]) -> dict[str, Any]:
    """Choices and depths as JSON holds them."""
    return {
        "choices": [asdict(choice) for choice in choices_of(places)],
        "depths": [asdict(depth) for depth in depths_of(places)],
    }
