"""Many readouts over the same cached features, each beside its pooled control; the best is kept."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import torch

from readouts.base import FrameReadout
from readouts.kinds import READOUTS, MapShape, Recipe
from readouts.local import RefinedReadout
from readouts.pooled import pooled_twin
from vidphys.data.labelled import LabelledFrames
from vidphys.progress import Progress
from vidphys.training.readouts import ReadoutFit, ReadoutSettings, train_readouts
from vidphys.training.refinement import train_refined

POOLED = "pooled"  # the kind of the controls
LOST = ReadoutFit(math.inf, 0, 0, math.nan)


@dataclass(frozen=True)
class Grid:
    """What the readouts over one layer differ in.

    Args:
        kind: name in :data:`readouts.kinds.READOUTS`.
        sizes: of the kind; what is not named keeps the kind's own.
        learning_rates: peaks.
        seeds: of initial weights.
    """

    kind: str
    sizes: Mapping[str, Sequence[int]]
    learning_rates: tuple[float, ...] = (3e-3,)
    seeds: tuple[int, ...] = (0,)

    def candidates(self, layer: int | str | None, shape: MapShape) -> list[Candidate]:
        """Every combination over one layer, and after them the control of each.

        Raises:
            ValueError: an unknown kind.
        """
        usual = READOUTS[self.kind].sizes
        tried = [self.sizes.get(name, (size,)) for name, size in usual.items()]
        recipes = [
            Recipe(self.kind, shape, dict(zip(usual, sizes, strict=True)))
            for sizes in product(*tried)
        ]
        found = [
            Candidate(recipe, layer, rate, seed)
            for recipe, rate, seed in product(recipes, self.learning_rates, self.seeds)
        ]
        controls = [] if self.kind == POOLED else [replace(each, control=True) for each in found]
        return found + controls


@dataclass(frozen=True)
class Candidate:
    """One readout of a grid.

    Args:
        recipe: what it is made by.
        layer: of the encoder.
        learning_rate, seed: see :class:`Grid`.
        control: it is the pooled readout with as many parameters.
    """

    recipe: Recipe
    layer: int | str | None
    learning_rate: float
    seed: int
    control: bool = False

    @property
    def kind(self) -> str:
        return POOLED if self.control else self.recipe.kind

    @property
    def name(self) -> str:
        """As it stands in the records."""
        layer = "" if self.layer is None else f"-layer{self.layer}"
        sizes = "".join(f"-{name}{size}" for name, size in self.recipe.sizes.items())
        return f"{self.kind}{layer}{sizes}-rate{self.learning_rate:g}-seed{self.seed}"

    def build(self) -> FrameReadout:
        """The untrained readout."""
        shape = self.recipe.shape
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            readout = self.recipe.build()
            if self.control:
                return pooled_twin(readout, shape.channels, shape.positions)
            return readout


@dataclass(frozen=True)
class TrainedReadout:
    """A candidate and what became of it."""

    candidate: Candidate
    module: FrameReadout
    fit: ReadoutFit


@dataclass(frozen=True)
class Examples:
    """Frames of one layer to train on and to stop by."""

    train: LabelledFrames
    held_out: LabelledFrames


def train_grid(
    grid: Grid,
    layer: int | str | None,
    shape: MapShape,
    examples: Examples,
    settings: ReadoutSettings,
    seed: int,
    folder: Path | None = None,
    progress: Progress | None = None,
    device: str = "cpu",
) -> list[TrainedReadout]:
    """Train all readouts of a grid over one layer.

    Args:
        grid: see :class:`Grid`.
        layer: the layer that the examples are of.
        shape: of its feature frames.
        examples: all of them are trained and compared on these.
        settings: of the training; the pooled readouts' maps are not moved.
        seed: of the batch order.
        folder: for checkpoints.
        progress: called as ``(step, steps, loss)``.
        device: where they are trained; they come back from there.

    Raises:
        FloatingPointError: every training was lost.
    """
    # pooling is blind to a move: moved maps would only teach the control that position is noise
    still = replace(settings, cells=0)
    every = grid.candidates(layer, shape)
    trained = []
    for kind in dict.fromkeys(each.kind for each in every):
        members = {each.name: each for each in every if each.kind == kind}
        modules = {name: each.build().to(device) for name, each in members.items()}
        rates = {name: each.learning_rate for name, each in members.items()}
        part = f"{kind}-{layer}" if layer is not None else kind
        how = still if kind == POOLED else settings
        save_to = None if folder is None else folder / part
        fits = _train(modules, rates, examples, how, seed, save_to, progress)
        trained += [TrainedReadout(members[n], modules[n].cpu().eval(), fits[n]) for n in members]
    return trained


def _train(
    modules: Mapping[str, FrameReadout],
    rates: Mapping[str, float],
    examples: Examples,
    settings: ReadoutSettings,
    seed: int,
    save_to: Path | None,
    progress: Progress | None,
) -> dict[str, ReadoutFit]:
    """Readouts of one kind in one pass over the examples; those of two parts one by one."""
    data = examples.train, examples.held_out
    if not any(isinstance(each, RefinedReadout) for each in modules.values()):
        file = None if save_to is None else save_to.with_name(f"{save_to.name}.json")
        return train_readouts(modules, rates, *data, settings, seed, file, progress)
    fits = {}
    for name, module in modules.items():
        assert isinstance(module, RefinedReadout)
        own = replace(settings, fit=replace(settings.fit, learning_rate=rates[name]))
        folder = None if save_to is None else save_to / name
        try:
            fits[name] = train_refined(module, *data, own, seed, folder, progress)
        except FloatingPointError:
            if len(fits) == len(modules) - 1 and all(fit is LOST for fit in fits.values()):
                raise
            fits[name] = LOST
    return fits


def best_of(kind: str, trained: Sequence[TrainedReadout]) -> TrainedReadout:
    """The readout of a kind with the smallest held-out error."""
    return min((t for t in trained if t.candidate.kind == kind), key=_error)


def _error(trained: TrainedReadout) -> float:
    return trained.fit.held_out_error
