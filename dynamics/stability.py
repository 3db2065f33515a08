"""How fast a model's terms can move, and whether a step resolves them.

The rate of a pair is omega^2 = |c(G) s_i s_j| K(r) (1 / m_i + 1 / m_j), K the steepest change of
its force with the distance, at r or beyond. It is an estimate by pairs, not a bound: many
bodies that pull on one at once are faster.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, cast
from weakref import WeakKeyDictionary

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from dynamics.around import Around
from dynamics.bound import Bound
from dynamics.each import Each
from dynamics.fields import EllipticTrap, Pendulum, Tether
from dynamics.hamiltonian import Hamiltonian
from dynamics.head import Head
from dynamics.kinetic import FixedKinetic
from dynamics.pairs import FEW, pair_indices, pair_tiles
from dynamics.potentials import HarmonicTrap, PairPotential
from dynamics.sliding import Along
from dynamics.state import Parameters, PhaseState
from dynamics.stiffness import QuadraticPotential

# World units: shortest and longest distance at which K is tabulated, and how many in each decade.
EXACT = 1e-8, 1e8, 40
LEARNED = 1e-4, 1e3, 10  # a network is smooth, and slow enough for its table to count
NUDGE = 1e-3  # relative step of the difference that gives a force's slope
LEAST_CHANGE = 0.1  # of the force, over a factor of e in distance, for its slope to count


@dataclass(frozen=True)
class Stiffest:
    """The fastest term of each episode.

    Args:
        rate: radians per second, ``(...)``.
        pair: bodies i < j, ``(..., 2)``; -1 where the term is not of a pair.
        term: name of the term that is fastest in the fastest episode.
    """

    rate: Float[Tensor, "*b"]
    pair: Int[Tensor, "*b 2"]
    term: str


def is_learned(part: nn.Module) -> bool:
    """Whether a part of a model has learned numbers."""
    return next(part.parameters(), None) is not None


class SteepnessTable:
    """K(r): the steepest change of a pair's force with the distance, at r or farther."""

    def __init__(self, potential: PairPotential, like: Tensor) -> None:
        shortest, longest, dense = LEARNED if is_learned(potential) else EXACT
        ends = math.log10(shortest), math.log10(longest)
        count = round((ends[1] - ends[0]) * dense)
        r = torch.logspace(*ends, count, dtype=like.dtype, device=like.device)
        # A learned pair energy need not be the same all round: along an axis, and slanted.
        axis = torch.eye(like.shape[-1], dtype=like.dtype, device=like.device)[0]
        n = torch.stack([axis, torch.ones_like(axis) / like.shape[-1] ** 0.5])
        near_and_nudged = torch.stack([r, r * (1 + NUDGE)])[..., None, None]
        with torch.no_grad():
            gradient = potential.pair_gradient(near_and_nudged * n)
        along = (gradient * n).sum(-1)
        # Along the line between the bodies: across it no law here changes faster. A force that
        # hardly depends on the distance may jump at r = 0 (a contact's cone); it stays finite.
        steepness = (along[1] - along[0]).abs().amax(-1) / (NUDGE * r)
        steepness[steepness * r < LEAST_CHANGE * along[0].abs().amax(-1)] = 0
        self.bounds = r.square()
        self.values = steepness.flip(0).cummax(0).values.flip(0)

    def at(self, squared: Tensor) -> Tensor:
        """K at squared distances."""
        index = torch.bucketize(squared.contiguous(), self.bounds, right=True) - 1
        return self.values[index.clamp_min(0)]


_LEARNED_TABLES: WeakKeyDictionary[nn.Module, tuple[Any, SteepnessTable]] = WeakKeyDictionary()


def steepness(potential: PairPotential, like: Tensor) -> SteepnessTable:
    """The table of a pair potential; that of a learned one is kept while its weights are the same.

    They are known by where they lie, by torch's count of their changes, and by their sums, because
    what is changed through ``.data`` is not counted.
    """
    weights = list(potential.parameters())
    if not weights:
        return SteepnessTable(potential, like)
    sums = torch.stack([weight.detach().sum() for weight in weights]).tolist()
    counts = [(weight.data_ptr(), weight._version) for weight in weights]
    key = like.dtype, like.device, like.shape[-1], sums, counts
    kept = _LEARNED_TABLES.get(potential)
    if kept is None or kept[0] != key:
        kept = _LEARNED_TABLES[potential] = key, SteepnessTable(potential, like)
    return kept[1]


class PairRates:
    """Squared rates of the pairs of one pair potential, in 1 / s^2."""

    def __init__(self, potential: PairPotential, params: Parameters, like: Tensor) -> None:
        self.name, self.law = type(potential).__name__, potential.law
        self.bodies, self.params = like.shape[-2], params
        self.table = steepness(potential, like)
        self.kept: Tensor | None = None
        if self.bodies * (self.bodies - 1) // 2 <= FEW:
            self.kept = self._weights(*pair_indices(self.bodies, like.device))

    def _weights(self, i: Tensor, j: Tensor) -> Tensor:
        """|c(G) s_i s_j| (1 / m_i + 1 / m_j), ``(..., pairs)``; kept where one tile has all."""
        if self.kept is not None:
            return self.kept
        strength, amount = self.law.strength(self.params)
        product = amount.index_select(-1, i) * amount.index_select(-1, j)
        mobility = 1 / self.params.mass
        loose = mobility.index_select(-1, i) + mobility.index_select(-1, j)
        return (strength.unsqueeze(-1) * product).abs() * loose

    def worst(self) -> Tensor:
        """The largest that any state can have, ``(...)``."""
        each = [
            self._weights(i, j).amax(-1) for i, j in self._tiles(self.params.mass.unsqueeze(-1))
        ]
        return torch.stack(each).amax(0) * self.table.values[0]

    def between(self, before: Tensor, after: Tensor) -> Tensor:
        """The largest on straight lines between positions ``(..., n, d)``, ``(...)``."""
        each = [self._squared(before, after, i, j).amax(-1) for i, j in self._tiles(before)]
        return each[0] if len(each) == 1 else torch.stack(each).amax(0)

    def at(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """The largest at positions, ``(...)``, and its pair ``(..., 2)``."""
        squared, pairs = q.new_full(q.shape[:-2], -1), q.new_zeros((*q.shape[:-2], 2)).long()
        for i, j in self._tiles(q):
            value, pair = self._squared(q, q, i, j).max(-1)
            larger = value > squared
            squared = torch.where(larger, value, squared)
            pairs = torch.where(larger.unsqueeze(-1), torch.stack([i[pair], j[pair]], -1), pairs)
        return squared, pairs

    def _squared(self, before: Tensor, after: Tensor, i: Tensor, j: Tensor) -> Tensor:
        """At the closest approach of each pair, ``(..., pairs)``."""
        apart = self.law.nearest(before.index_select(-2, i) - before.index_select(-2, j))
        if before is not after:
            moved = after - before
            way = self.law.nearest(moved.index_select(-2, i) - moved.index_select(-2, j))
            length = way.square().sum(-1, keepdim=True).clamp_min(torch.finfo(way.dtype).tiny)
            apart = apart - ((apart * way).sum(-1, keepdim=True) / length).clamp(-1, 0) * way
        return self._weights(i, j) * self.table.at(apart.square().sum(-1))

    def _tiles(self, q: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
        return pair_tiles(self.bodies, q.shape[:-2].numel(), q.device)

    def of(self, index: Tensor) -> PairRates:
        """The same for some episodes of a flat batch, by index."""
        part = copy.copy(self)
        part.params = self.params[index]
        part.kept = None if self.kept is None else self.kept[index]
        return part


class ConstantRates:
    """Those of a force that is linear in the positions: the same everywhere, of no pair."""

    def __init__(self, name: str, squared: Tensor) -> None:
        self.name, self.squared = name, squared

    def worst(self) -> Tensor:
        return self.squared

    def between(self, before: Tensor, after: Tensor) -> Tensor:
        return self.squared

    def at(self, q: Tensor) -> tuple[Tensor, Tensor]:
        return self.squared, torch.full((*self.squared.shape, 2), -1, device=q.device)

    def of(self, index: Tensor) -> ConstantRates:
        return ConstantRates(self.name, self.squared[index])


Rates = PairRates | ConstantRates


def flat_parameters(params: Parameters, batch: torch.Size) -> Parameters:
    """The parameters of every episode of a batch, along one axis."""
    of_bodies = (*batch, params.mass.shape[-1])

    def spread(x: Tensor) -> Tensor:
        whole = x.expand(of_bodies if x is params.mass or x is params.charge else batch)
        return whole.reshape(batch.numel(), *whole.shape[len(batch) :])

    return params.map(spread)


def rates_of(head: Head, start: PhaseState, params: Parameters) -> list[Rates]:
    """What is known of the rates of a model's terms; nothing of learned ones that are not pairs.

    Args:
        head: any; only a :class:`Hamiltonian` with the kinetic energy |p|^2 / 2m has rates here,
            by itself or bound.
        start: gives sizes, dtype and device.
        params: of every episode of the batch, ``(...)``, not broadcast.
    """
    if isinstance(head, Bound):  # pairs are rated by places, and it has coordinates
        rates = rates_of(head.law, start, params)
        return [rate for rate in rates if isinstance(rate, ConstantRates)]
    if isinstance(head, Each):
        return [rate for each in head.laws for rate in rates_of(cast(Head, each), start, params)]
    if isinstance(head, Around):
        head = head.free
    if not isinstance(head, Hamiltonian) or not isinstance(head.kinetic, FixedKinetic):
        return []
    found: list[Rates] = []
    with torch.no_grad():
        for part in cast(nn.Module, head.potential).modules():
            if isinstance(part, PairPotential) and start.q.shape[-2] > 1:
                found.append(PairRates(part, params, start.q))
            elif isinstance(part, HarmonicTrap):
                squared = abs(cast(float, part.stiffness)) / params.mass.amin(-1)
                found.append(ConstantRates("HarmonicTrap", squared))
            elif isinstance(part, Tether):
                squared = part.stiffness.abs() / params.mass.amin(-1)
                found.append(ConstantRates("Tether", squared))
            elif isinstance(part, Along):
                squared = (part.curve.sharpest * part.acceleration.norm()).to(params.mass)
                found.append(ConstantRates("Along", squared.expand(params.coupling.shape)))
            elif isinstance(part, EllipticTrap):
                steepest = torch.linalg.eigvalsh(part.stiffness).abs().amax()
                found.append(ConstantRates("EllipticTrap", steepest / params.mass.amin(-1)))
            elif isinstance(part, Pendulum):
                squared = part.rate2.abs().to(params.mass).expand(params.coupling.shape)
                found.append(ConstantRates("Pendulum", squared))
            elif isinstance(part, QuadraticPotential):
                root = params.mass.rsqrt()
                matrix = root.unsqueeze(-1) * part.stiffness(params.coupling) * root.unsqueeze(-2)
                squared = torch.linalg.eigvalsh(matrix).abs().amax(-1)
                found.append(ConstantRates("QuadraticPotential", squared))
    return found


def stiffest(rates: Sequence[Rates], q: Float[Tensor, "*b n d"]) -> Stiffest:
    """The fastest of some terms at positions ``(..., n, d)``.

    Example:
        >>> head = Hamiltonian(FixedKinetic(), HarmonicTrap(4.0))
        >>> start = PhaseState(torch.ones(1, 2, 2), torch.zeros(1, 2, 2))
        >>> law = Parameters(torch.ones(1), torch.ones(1, 2))
        >>> found = stiffest(rates_of(head, start, law), start.q)
        >>> found.term, found.rate.tolist()  # radians per second
        ('HarmonicTrap', [2.0])
    """
    squared, pairs = (torch.stack(x) for x in zip(*[rate.at(q) for rate in rates], strict=True))
    largest, which = squared.max(0)
    pair = pairs.gather(0, which[None, ..., None].expand(1, *pairs.shape[1:])).squeeze(0)
    term = rates[int(which.flatten()[largest.flatten().argmax()])].name
    return Stiffest(largest.sqrt(), pair, term)
