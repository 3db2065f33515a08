"""Parts of other packages: their checkers, and the extremes that ours are put to."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import torch

from dynamics import HEADS, Head, build, rollout
from dynamics.terms import TERMS, Hamiltonian, HeadTerm, PotentialTerm
from encoders.frozen import ENCODERS, load_encoder
from registry import Registry
from vidphys.scenes import SCENES
from vidphys.stress.bodies import STEP
from vidphys.stress.case import ANY_HONEST, REFUSED, SOUND, Case, Skip
from vidphys.testing import check_encoder, check_scene, check_term
from vidphys.testing.states import episodes, law, moving_dots

BODIES, STEPS = 3, 20
LONG, LONG_STEPS = 500.0, 5  # times the study's step, and how many such steps
FINER = 16  # times the steps of what a long step is compared with
ODD = (37, 50)  # pixels (height, width) that no cell divides


def parts() -> Iterator[Case]:
    """The checker of each part and its extremes; none where no other package is installed."""
    for name in TERMS.foreign():
        yield _case(TERMS, name, "its checker", 0.0, partial(_checked, _term, name), SOUND)
        yield from _of_model(TERMS, name, _term)
    for name in HEADS.foreign():
        yield _case(HEADS, name, "its checker", 0.0, partial(_checked, HEADS.get, name), SOUND)
        yield from _of_model(HEADS, name, HEADS.__getitem__)
    for name in SCENES.foreign():
        yield _case(SCENES, name, "its checker", 0.0, partial(_passes, check_scene, name), SOUND)
    for name in ENCODERS.foreign():
        yield _case(
            ENCODERS, name, "its checker", 0.0, partial(_passes, check_encoder, name), SOUND
        )
        for frames, (height, width) in ((1, (32, 32)), (5, ODD)):
            shown = f"{frames} frames of {height} x {width}"
            yield _case(ENCODERS, name, shown, frames, partial(_seen, name, frames, height, width))


def _of_model(registry: Registry[Any], name: str, term: Callable[[str], Any]) -> Iterator[Case]:
    yield _case(registry, name, "a long step", LONG, partial(_long_step, term, name))
    yield _case(registry, name, "bodies in one place", 0.0, partial(_coincident, term, name))
    for value in (math.nan, math.inf):
        run = partial(_spoiled, term, name, value)
        yield _case(registry, name, f"a position is {value}", 1.0, run, REFUSED)


def _case(
    registry: Registry[Any],
    name: str,
    extreme: str,
    value: float,
    run: Callable[[], float],
    *must: str,
) -> Case:
    return Case(
        "foreign",
        f"{registry.what} {name} of {registry.source(name)}",
        extreme,
        value,
        run,
        1e-2,
        "own",
        path="any",
        must=must or ANY_HONEST,
        home=registry.home(name),
    )


def _passes(check: Callable[[str], None], name: str) -> float:
    check(name)
    return 0.0


def _term(name: str) -> Any:
    try:
        return TERMS[name]()
    except TypeError as error:
        raise Skip(f"{name} is not made without arguments: {error}") from error


def _checked(term: Callable[[str], Any], name: str) -> float:
    check_term(term(name))
    return 0.0


def _model(term: Any) -> Head:
    if isinstance(term, PotentialTerm):
        term = Hamiltonian(potentials=(term,))
    if not isinstance(term, HeadTerm):
        raise Skip("no model by itself")
    torch.manual_seed(0)
    return build(term, BODIES, STEP).double().eval()


def _long_step(term: Callable[[str], Any], name: str) -> float:
    """Away from the same time in small steps, relative to how far the bodies move."""
    head, start, params = _model(term(name)), episodes(BODIES, 2), law(BODIES)
    if head.dt is not None:
        rollout(head, start, params, LONG_STEPS, LONG * STEP)
        return math.inf
    long = rollout(head, start, params, LONG_STEPS, LONG * STEP, substeps=False)
    with torch.no_grad():
        small = rollout(head, start, params, FINER * LONG_STEPS, LONG * STEP / FINER, FINER)
    moved = (small.states.q - start.q[:, None]).abs().amax()
    return float((long.states.q - small.states.q).abs().amax() / moved)


def _coincident(term: Callable[[str], Any], name: str) -> float:
    head, start = _model(term(name)), episodes(BODIES, 2)
    together = type(start)(torch.zeros_like(start.q), start.p)
    found = rollout(head, together, law(BODIES), STEPS, STEP if head.dt is None else head.dt)
    return 0.0 if bool(torch.isfinite(found.states.flat).all()) else math.inf


def _spoiled(term: Callable[[str], Any], name: str, value: float) -> float:
    head, start = _model(term(name)), episodes(BODIES, 2)
    start.q[0, 0, 0] = value
    rollout(head, start, law(BODIES), STEPS, STEP if head.dt is None else head.dt)
    return math.inf


def _seen(name: str, frames: int, height: int, width: int) -> float:
    pictures, times = moving_dots(1, frames, max(height, width))
    found = load_encoder(name, {})(pictures[..., :height, :width], times).values
    return 0.0 if bool(torch.isfinite(found).all()) else math.inf
