"""What is checked of a rollout: before it starts, and before its result can be believed."""

from __future__ import annotations

import math
from contextlib import nullcontext
from typing import cast

import torch
from torch import Tensor

from dynamics.domain import EXTENTS, FAR, extents, largest
from dynamics.findings import (
    DomainWarning,
    EnergyWarning,
    FailureWarning,
    Finding,
    RoundingWarning,
    StabilityWarning,
    counted,
    first,
)
from dynamics.head import Head
from dynamics.potentials import Potential
from dynamics.stability import Rates, flat_parameters, is_learned, stiffest
from dynamics.state import Parameters, PhaseState
from loops.threads import held_to

NOT_BELIEVED = 1.0  # omega * dt of a fixed step; a harmonic oscillator diverges at 2
ENERGY_LOST = 1e-2  # relative drift from which on a conserving model is not believed
NEAR_ZERO = 0.1  # of K + |V|: a smaller energy is not what drift is relative to
HIDDEN = 5e-3  # of the way that bodies move: rounding of positions from which on it is not believed
# States whose energy is looked at: all while they are few, by whether the model is learned; else
# the two ends and one in so many steps.
FEW_STATES, SHARE = {True: 64, False: 8192}, {True: 1000, False: 100}
# Numbers from which on torch shares them among threads. A root of MKL's does it with any, and waits
# for the others longer than it takes.
SHARED = 2**15


def start(start: PhaseState, params: Parameters, dt: float) -> None:
    """Refuse what cannot be integrated.

    Raises:
        ValueError: ``dt`` or a number of the state or the parameters is not finite (which one is
            said), the state is of less than single precision, or the parameters are of other
            bodies or episodes.
    """
    if not math.isfinite(dt):
        raise ValueError(f"rollout: dt must be a finite number of seconds, got {dt}")
    for dtype in {start.q.dtype, start.p.dtype}:
        if dtype not in (torch.float32, torch.float64):
            raise ValueError(
                f"rollout: a state of {dtype} is too coarse to integrate: a step's increments "
                "vanish in its rounding; pass start.map(torch.Tensor.float)"
            )
    named = {"q": start.q, "p": start.p, "coupling": params.coupling, "mass": params.mass}
    if params.charge is not None:
        named["charge"] = params.charge
    named |= params.scalars
    _shapes(start.q.shape, params)
    # A sum that is finite has finite terms, and is found with fewer operations.
    if math.isfinite(sum(float(value.sum()) for value in named.values())):
        return
    for name, value in named.items():
        if not bool(torch.isfinite(value).all()):
            where = tuple(torch.nonzero(~torch.isfinite(value))[0].tolist())
            raise ValueError(
                f"rollout: {name}{list(where) if where else ''} is not finite; repair or drop it"
            )


def _shapes(state: torch.Size, params: Parameters) -> None:
    """Refuse parameters of other bodies or episodes than the state's ``(..., n, d)``."""
    if len(state) < 2:
        raise ValueError(f"rollout: a state is (..., bodies, space), got {tuple(state)}")
    batch, bodies = state[:-2], state[-2]
    own = {"coupling": params.coupling, **params.scalars}
    for name, wanted, value in (
        ("mass", (*batch, bodies), params.mass),
        ("charge", (*batch, bodies), params.charge),
        *((name, tuple(batch), value) for name, value in own.items()),
    ):
        if value is None:
            continue
        shape = tuple(value.shape)
        last = shape[-1:] == (bodies,) or name not in ("mass", "charge")
        if not (last and _fits(shape, wanted)):
            raise ValueError(
                f"rollout: {name} is {shape}, but a state of {bodies} bodies {tuple(state)} needs "
                f"{wanted}; give one for each {'body' if name in ('mass', 'charge') else 'episode'}"
            )


def _fits(shape: tuple[int, ...], wanted: tuple[int, ...]) -> bool:
    """Whether an array can be spread over another."""
    ends = zip(reversed(shape), reversed(wanted), strict=False)
    return len(shape) <= len(wanted) and all(a in (1, b) for a, b in ends)


def same_precision(head: Head, start: PhaseState, params: Parameters) -> None:
    """Refuse a state or parameters of another precision than the networks of a model.

    Raises:
        ValueError: they are.
    """
    weight = next((m.weight for m in head.modules() if isinstance(m, torch.nn.Linear)), None)
    if weight is None:
        return
    own = str(weight.dtype).removeprefix("torch.")
    given = {"state": start.q, "coupling": params.coupling, "mass": params.mass}
    for name, value in given.items():
        if value.dtype != weight.dtype:
            other = str(value.dtype).removeprefix("torch.")
            raise ValueError(
                f"rollout: the networks of {type(head).__name__} are {own}, the {name} is {other}; "
                f"map the state and the parameters: start.map(lambda x: x.to(torch.{own}))"
            )


def fixed_step(rates: list[Rates], states: PhaseState, dt: float, every: int) -> list[Finding]:
    """Stored states at which a whole step is too long for the fastest term.

    Args:
        rates: of the flat batch of episodes.
        states: ``(..., t, n, d)``.
        dt: seconds of a step.
        every: steps between stored states.
    """
    batch, stored = states.q.shape[:-3], states.q.shape[-3]
    who = torch.arange(batch.numel(), device=states.q.device).repeat_interleave(stored)
    q = states.q.reshape(-1, *states.q.shape[-2:])
    found = stiffest([rate.of(who) for rate in rates], q)
    turn = (found.rate * abs(dt)).reshape(*batch, stored)
    long = turn > NOT_BELIEVED
    if not bool(long.any()):
        return []
    episodes = long.any(-1)
    one = (*first(episodes), int(long[first(episodes)].int().argmax()))
    pair = found.pair.reshape(*batch, stored, 2)[one].tolist()
    text = (
        f"omega * dt = {float(turn[one]):.3g} for {named(found.term, pair)} at step "
        f"{one[-1] * every}, in {counted(episodes)}: a step of {dt:g} s does not resolve it "
        f"(above 2 leapfrog diverges); use a dt below {abs(dt) / float(turn[one]):.2g} s"
    )
    body = pair[0] if pair[0] >= 0 else None
    return [Finding(StabilityWarning, text, episodes, one[-1] * every, body, found.term)]


def named(term: str, pair: list[int]) -> str:
    """A term and its pair in words."""
    return term if pair[0] < 0 else f"{term} of bodies {pair[0]} and {pair[1]}"


def energy_drift(head: Head, states: PhaseState, params: Parameters) -> Tensor:
    """|E - E_0| of a conserving model over |E_0|, or over a tenth of K + |V| where that is more.

    Args:
        head: has an energy.
        states: ``(..., t, n, d)``, the start first.
        params: of the episodes, ``(...)``.

    Returns:
        ``(..., t)``.
    """
    energy = _energies(head, states, params)
    return (energy - energy[..., :1]).abs() / _size(head, states, params, energy[..., 0])


def _energies(head: Head, states: PhaseState, params: Parameters) -> Tensor:
    """Of each state, ``(..., t)``."""
    batch, stored = states.q.shape[:-3], states.q.shape[-3]
    law, flat = flat_parameters(params, batch), states.map(lambda x: x.reshape(-1, *x.shape[-2:]))
    who = torch.arange(batch.numel(), device=states.q.device)
    return _energy(head, flat, law[who.repeat_interleave(stored)]).reshape(*batch, stored)


def _size(head: Head, states: PhaseState, params: Parameters, energy: Tensor) -> Tensor:
    """What the drift from a start of this ``energy`` ``(...)`` is relative to, ``(..., 1)``."""
    start = states.q[..., :1, :, :]
    rest = _energies(head, PhaseState(start, torch.zeros_like(start)), params)[..., 0]
    size = torch.maximum(energy.abs(), NEAR_ZERO * ((energy - rest).abs() + rest.abs()))
    return size.clamp_min(torch.finfo(size.dtype).tiny).unsqueeze(-1)


def _energy(head: Head, state: PhaseState, params: Parameters) -> Tensor:
    return cast(Tensor, head.energy(state, params))  # type: ignore[operator]


def energy(
    head: Head, states: PhaseState, params: Parameters, every: int, closely: bool
) -> list[Finding]:
    """Whether a conserving model kept its energy at the stored states, or at some of them.

    Args:
        head: of any kind.
        states: ``(..., t, n, d)``.
        params: of the episodes.
        every: steps between stored states.
        closely: look at all stored states, however many they are.
    """
    stored, batch = states.q.shape[-3], states.q.shape[:-3].numel()
    if not head.conserves or not states.q.numel() or stored < 2:
        return []
    learned = is_learned(head)
    few = stored * batch <= FEW_STATES[learned]
    count = stored if closely or few else 2 + stored * every // SHARE[learned]
    looked = torch.linspace(0, stored - 1, min(count, stored)).round().long().to(states.q.device)
    # An index, not index_select, which makes a contiguous copy of all states first.
    states = states.map(lambda x: x[..., looked, :, :])
    with held_to(1) if states.q.numel() < SHARED else nullcontext():
        energy = _energies(head, states, params)
    change = (energy - energy[..., :1]).abs()
    if not bool((change > ENERGY_LOST * energy[..., :1].abs()).any()):
        return []  # what drift is relative to is no less: the potential energy need not be asked
    drift = change / _size(head, states, params, energy[..., 0])
    lost = drift > ENERGY_LOST
    if not bool(lost.any()):
        return []
    episodes = lost.any(-1)
    step = int(looked[int(lost[first(episodes)].int().argmax())]) * every
    text = (
        f"the energy of {type(head).__name__} drifts by {float(drift[lost].max()):.2g} of itself "
        f"in {counted(episodes)}, first seen at step {step}, although the model conserves it; use "
        "a smaller dt or an integrator of higher order (kahan_li8)"
    )
    return [Finding(EnergyWarning, text, episodes, step)]


def domain(
    head: Head, states: PhaseState, every: int, reached: dict[str, float] | None = None
) -> list[Finding]:
    """Whether a learned model came to states far from those that it was trained on.

    Args:
        head: of any kind.
        states: ``(..., t, n, d)``.
        every: steps between stored states.
        reached: see :class:`dynamics.head.Trajectory`.
    """
    known = dict(zip(EXTENTS, head.domain.tolist(), strict=True))
    watched = [name for name in head.depends_on if math.isfinite(known[name])]
    if not watched or not states.q.numel():
        return []
    reach = reached or {}
    if not all(name in reach for name in watched):
        reach = largest(states, watched, head.box)
    if all(reach[name] <= FAR * known[name] for name in watched):
        return []
    each = extents(states, head.box)
    for name in watched:
        far = each[..., EXTENTS.index(name)] > FAR * known[name]
        if bool(far.any()):
            episodes = far.any(-1)
            step = int(far[first(episodes)].int().argmax()) * every
            text = (
                f"{type(head).__name__} is asked about a {name} more than {FAR:g} times the "
                f"largest of its training ({known[name]:.3g}), in {counted(episodes)}, first at "
                f"step {step}: what it says there was never checked"
            )
            return [Finding(DomainWarning, text, episodes, step)]
    return []


def rounding(states: PhaseState, every: int) -> list[Finding]:
    """Whether positions are kept finely enough for the way that the bodies move.

    A step adds a little to a position that may be far from the origin; what is lost each time adds
    up as a random walk. The way is the largest of any body, at three stored states.
    """
    stored, q = states.q.shape[-3], states.q
    if stored < 2 or not q.numel():
        return []
    three = [0, stored // 2, stored - 1]
    few = q[..., three, :, :].flatten(-2)
    moved = (few - few[..., :1, :]).abs().amax((-2, -1))
    size, steps = few.abs().amax((-2, -1)), (stored - 1) * every
    lost = torch.finfo(q.dtype).eps * steps**0.5 * size
    hidden = lost > HIDDEN * moved
    if not bool(hidden.any()):
        return []
    # what starts at rest has a momentum later, also where its position cannot show it
    episodes = hidden & (states.p[..., three, :, :] != 0).flatten(-3).any(-1)
    if not bool(episodes.any()):
        return []
    one = first(episodes)
    text = (
        f"positions near {float(size[one]):.3g} are kept to {float(lost[one]):.1g} over {steps} "
        f"steps of {q.dtype}, in {counted(episodes)} whose bodies move by {float(moved[one]):.1g}: "
        "move the origin to the scene, or use float64"
    )
    return [Finding(RoundingWarning, text, episodes)]


def failure(
    head: Head, states: PhaseState, params: Parameters, first_bad: Tensor, dt: float, every: int
) -> list[Finding]:
    """Step, body and term of the first episode that is not finite.

    Args:
        head: of any kind.
        states: ``(..., t, n, d)``.
        params: of the episodes.
        first_bad: index of the first bad stored state of each episode, or less than 0.
        dt: seconds of a step.
        every: steps between stored states.
    """
    episodes = first_bad >= 0
    if not bool(episodes.any()):
        return []
    one = first(episodes)
    index = int(first_bad[one])
    last, law = states[one][index - 1], flat_parameters(params, first_bad.shape)
    numbers = torch.arange(first_bad.numel(), device=first_bad.device)
    law = law[int(numbers.reshape(first_bad.shape)[one])]
    step, bad, memory = (index - 1) * every, last, None
    with torch.no_grad(), torch.random.fork_rng([]):
        for _ in range(every):
            last, step = bad, step + 1
            bad, memory = head.advance(last, law, dt, memory)
            if not bool(torch.isfinite(bad.flat).all()):
                break
        else:  # it does not happen again: the noise was another, or the steps were
            step, bad = index * every, states[one][index]
    wrong = ~(torch.isfinite(bad.q) & torch.isfinite(bad.p)).all(-1)
    body = int(wrong.int().argmax())
    term = failing_term(head, [last, bad], law)
    text = (
        f"not finite at step {step}: body {body}, by {term}, in {counted(episodes)}; what was "
        "stored before is kept, use a smaller dt or look at the parameters"
    )
    return [Finding(FailureWarning, text, episodes, step, body, term)]


def failing_term(head: Head, states: list[PhaseState], params: Parameters) -> str:
    """The innermost term of a model whose force is not finite at finite positions, or the model."""
    places = [state.q for state in states if bool(torch.isfinite(state.q).all())]
    for part in head.modules():
        if part is head or not isinstance(part, Potential) or hasattr(part, "parts"):
            continue
        if not all(bool(torch.isfinite(part.force(q, params)).all()) for q in places):
            return type(part).__name__
    return type(head).__name__
