"""The checkers accept all of ours, and refuse each part that was broken on purpose."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from binders import BINDERS, MotionBinder, MotionTracks
from dynamics import HEADS, Hamiltonian, Parameters, PhaseState, terms
from dynamics.integrators import Integrator, leapfrog
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import HarmonicTrap, SoftenedGravity
from encoders import FeatureMap
from readouts import READOUTS, FrameReadout, MapShape, Recipe
from vidphys.data.formats import Recording, TrackFormat
from vidphys.data.formats.tables import read_text
from vidphys.scenes import SCENES, Scene, gravity
from vidphys.testing import (
    CheckFailed,
    check_binder,
    check_encoder,
    check_format,
    check_head,
    check_readout,
    check_scene,
    check_term,
)
from vidphys.testing.readouts import CHANNELS, GRID
from vidphys.testing.states import episodes, law

JOINTS = ("generalised-hamiltonian", "lagrangian")  # of angles, one each
ASKED: dict[str, terms.Term] = {
    "trap": terms.Trap(2.0),
    "shortcut": terms.Shortcut((terms.Radial(width=8),)),
    "walled": terms.Walled(terms.Hamiltonian(), 5.0, 0.5, (1.0, 0.0)),
    "pendulum": terms.Pendulum(4.0),
    "elliptic-trap": terms.EllipticTrap(((4.0, 1.0), (1.0, 9.0)), (0.5, 0.0)),
    "well": terms.Well(4.0, 0.3, 0.5, -0.2),
    "tether": terms.Tether(4.0, 0.5, (0.3, -6.0)),
    "centre": terms.Centre(-4.0, 1.7, (0.3, -6.0), near=2.0),
    "turning": terms.Turning((0.7,)),
    "strung": terms.Strung(terms.Hamiltonian(), (0.0, 0.0), 100.0),
}
REFUSED = ("state-dependent-bath",)  # says why it cannot be built
DISKS = "hard-disks"  # may not overlap, as the bodies of the other checks do
IMPULSES = ("free-impulse", "restitution")  # act at once where bodies meet
# of places on a curve, where states of other checks are not; see tests/dynamics/test_bound.py
BOUND = (
    *("on-line", "on-arc", "on-curve", "on-chain"),
    *("links", "spring", "contact", "each", "along", "rubbed", "placewise-friction"),
)
CLOCKED = ("clocked", "sinusoid", "lift")  # ask for a clock; see tests/dynamics/test_clocked.py
SPECIAL = (*JOINTS, *REFUSED, DISKS, *BOUND, *CLOCKED)


@pytest.mark.parametrize("name", [name for name in terms.TERMS if name not in SPECIAL])
def test_every_term_of_ours_passes(name: str) -> None:
    term = ASKED[name] if name in ASKED else terms.TERMS[name]()
    check_term(term, impulsive=name in IMPULSES)


@pytest.mark.parametrize("name", JOINTS)
def test_models_of_joints_pass(name: str) -> None:
    check_head(terms.TERMS[name](), bodies=2, space=1)


@pytest.mark.parametrize("name", HEADS.ours())
def test_every_head_of_ours_passes(name: str) -> None:
    check_head(HEADS[name])


@pytest.mark.parametrize("name", SCENES.ours())
def test_every_scene_passes(name: str) -> None:
    check_scene(name)


@pytest.mark.parametrize("name", READOUTS.ours())
def test_every_readout_passes(name: str) -> None:
    check_readout(name)


@pytest.mark.parametrize("name", BINDERS.ours())
def test_every_binder_passes(name: str) -> None:
    check_binder(name)


@pytest.mark.parametrize("name", ["dino-tiny", "videomae-tiny", "vjepa2-tiny"])
def test_encoders_whose_weights_are_here_pass(name: str) -> None:
    check_encoder(name)


def files(folder: Path) -> dict[str, Path]:
    rows = [(k / 10, k, 1.0) for k in range(9)]
    (folder / "a.csv").write_text("t,x1,y1\n" + "".join(f"{t},{x},{y}\n" for t, x, y in rows))
    (folder / "a.txt").write_text("% t x1 y1\n" + "".join(f"{t} {x} {y}\n" for t, x, y in rows))
    np.savez(folder / "a.npz", positions=np.zeros((9, 1, 2)))
    return {"csv": folder / "a.csv", "text": folder / "a.txt", "npz": folder / "a.npz"}


@pytest.mark.parametrize("name", ["csv", "text", "npz"])
def test_formats_pass(name: str, tmp_path: Path) -> None:
    check_format(name, files(tmp_path)[name])


# broken parts


class Trap(HarmonicTrap):
    """One that can be broken at one place."""

    def __init__(self, broken: str) -> None:
        super().__init__(2.0)
        self.broken = broken

    def energy(self, q: Tensor, params: Parameters) -> Tensor:
        if self.broken == "single precision":
            return super().energy(q.float(), params).double()
        if self.broken == "energy over the batch":
            return super().energy(q, params) + 0 * params.coupling + q.mean().square()
        return super().energy(q, params)

    def force(self, q: Tensor, params: Parameters) -> Tensor:
        force = super().force(q, params)
        return {
            "wrong sign": lambda: -force,
            "single precision": lambda: super(Trap, self).force(q.float(), params).double(),
            "silent NaN": lambda: torch.nan_to_num(force),
            "cut gradient": force.detach,
            "state over the batch": lambda: force - force.mean(0) if force.ndim > 2 else force,
        }.get(self.broken, lambda: force)()


BROKEN = {
    "wrong sign": "minus the gradient of its energy",
    "single precision": "float32 from float32|single precision on the way|minus the gradient",
    "silent NaN": "not finite",
    "cut gradient": "gradient",
    "state over the batch": "alone as in company|minus the gradient",
}


@pytest.mark.parametrize("broken", BROKEN)
def test_a_broken_potential_is_refused(broken: str) -> None:
    check_head(Hamiltonian(FixedKinetic(), Trap("")))
    with pytest.raises(CheckFailed, match=BROKEN[broken]):
        check_head(Hamiltonian(FixedKinetic(), Trap(broken)))


def test_a_force_that_is_not_answered_is_refused() -> None:
    class Selfish(SoftenedGravity):
        def force(self, q: Tensor, params: Parameters) -> Tensor:
            return super().force(q, params) * torch.tensor([1.0, 1.0, 0.5]).double()[:, None]

    @dataclass(frozen=True)
    class Term(terms.PotentialTerm):
        def build(self, sizes: terms.Sizes) -> Any:
            return Selfish(0.3)

    terms.TERMS.register("selfish", Term)
    try:
        with pytest.raises(CheckFailed):
            check_term(Term())
    finally:
        terms.TERMS._parts.pop("selfish")
        terms.TERMS._modules.pop("selfish")


def euler(field: Any, state: PhaseState, dt: float, memory: Any) -> tuple[PhaseState, None]:
    p = state.p + dt * field.force(state.q, state.p)
    return PhaseState(state.q + dt * field.velocity(state.q, p), p), None


def test_a_method_of_lower_order_than_it_says_is_refused() -> None:
    wrong = Integrator("wrong", 2, True, 1, True, euler)
    check_head(Hamiltonian(FixedKinetic(), SoftenedGravity(0.3), leapfrog))
    with pytest.raises(CheckFailed, match="to the power of 2, got [01]"):
        check_head(Broken("", wrong))


class Broken(Hamiltonian):
    """A head that is broken in its step."""

    def __init__(self, broken: str, integrator: Integrator = leapfrog) -> None:
        super().__init__(FixedKinetic(), SoftenedGravity(0.3), integrator)
        self.broken, self.calls = broken, 0

    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Any = None
    ) -> tuple[PhaseState, Any]:
        after, memory = super().advance(state, params, dt, memory)
        self.calls += 1
        if self.broken == "remembers":
            after = after.map(lambda x: x * (1 + 1e-12 * self.calls))
        if self.broken == "float64 always":
            after = after.map(Tensor.double)
        if self.broken == "silent NaN":
            after = after.map(torch.nan_to_num)
        if self.broken == "writes":
            state.p.mul_(1.5)
        if self.broken == "bodies by their number":
            after = PhaseState(after.q, after.p + 1e-3 * torch.arange(3)[:, None])
        return after, memory


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        ("remembers", "the same answer twice"),
        ("float64 always", "float32 from float32"),
        ("silent NaN", "not finite, got a finite answer"),
        ("writes", "its input left as it was"),
        ("bodies by their number", "equal bodies to change places"),
    ],
)
def test_a_broken_step_is_refused(broken: str, said: str) -> None:
    with pytest.raises(CheckFailed, match=said):
        check_head(Broken(broken), exchangeable=True)


def test_a_head_that_no_worker_can_be_handed_is_refused() -> None:
    head = Broken("")
    head.secret = lambda: None  # type: ignore[assignment]
    with pytest.raises(CheckFailed, match="pickled for a worker"):
        check_head(head)


def test_a_term_that_forgets_is_refused() -> None:
    @dataclass(frozen=True)
    class Forgets(terms.Trap):
        def build(self, sizes: terms.Sizes) -> Any:
            return HarmonicTrap(torch.rand(()).item())

    assert issubclass(Forgets, terms.Trap)  # a class in a function has no path to come back by
    with pytest.raises((CheckFailed, ValueError, AttributeError)):
        check_term(Forgets(2.0))


class Means:
    """A plain encoder that can be broken."""

    def __init__(self, broken: str = "") -> None:
        self.broken, self.calls = broken, 0

    def __call__(self, frames: Tensor, times: Tensor) -> FeatureMap:
        self.calls += 1
        values = torch.nn.functional.avg_pool2d(frames.flatten(0, 1), 8)
        values = values.unflatten(0, frames.shape[:2])
        stride = (8.0, 8.0)
        if self.broken == "batch statistics":
            values = (values - values.mean()) / values.std()
        if self.broken == "remembers":
            values = values + 0.01 * self.calls
        if self.broken == "silent NaN":
            values = torch.nan_to_num(values)
        if self.broken == "frames as times":
            times = torch.arange(len(times)).double()
        if self.broken == "blind":
            values = torch.zeros_like(values)
        if self.broken == "stride":
            stride = (1.0, 1.0)
        return FeatureMap(values, stride, times)


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        ("batch statistics", "a clip alone as in company"),
        ("remembers", "the same features twice|alone as in company"),
        ("frames as times", "seconds within the clip"),
        ("blind", "other features of other frames"),
        ("stride", "grid times stride"),
    ],
)
def test_a_broken_encoder_is_refused(broken: str, said: str) -> None:
    check_encoder(Means())
    with pytest.raises(CheckFailed, match=said):
        check_encoder(Means(broken))


@dataclass(frozen=True)
class BrokenBinder:
    """The binder of ours, broken."""

    broken: str
    bodies: int

    def __call__(self, frames: np.ndarray, times: np.ndarray) -> MotionTracks:
        found = MotionBinder(self.bodies, shadow=1.0)(frames, times)
        tracks = found.tracks
        changed = {
            "pixels": lambda: replace(tracks, positions=48 * tracks.positions),
            "upside down": lambda: replace(tracks, positions=-tracks.positions),
            "frames": lambda: replace(tracks, times=25 * tracks.times),
            "sure": lambda: replace(tracks, confidence=2 * tracks.confidence),
        }
        return replace(found, tracks=changed.get(self.broken, lambda: tracks)())


@pytest.mark.parametrize("broken", ["pixels", "upside down", "frames", "sure"])
def test_a_broken_binder_is_refused(broken: str) -> None:
    check_binder(partial(BrokenBinder, ""))
    with pytest.raises(CheckFailed):
        check_binder(partial(BrokenBinder, broken))


class BrokenReadout(FrameReadout):
    """The mean readout of ours, broken."""

    def __init__(self, broken: str) -> None:
        super().__init__()
        self.broken = broken
        self.inner = Recipe("attention", MapShape(CHANNELS, GRID, 2), {"width": 16}).build()

    def read(self, values: Tensor, centres: Tensor) -> tuple[Tensor, Tensor]:
        positions, sure = self.inner.read(values, centres)
        changed: dict[str, Callable[[], tuple[Tensor, Tensor]]] = {
            "pixels": lambda: (32 * (positions + 1), sure),
            "sure": lambda: (positions, 1 + sure),
            "company": lambda: (positions - positions.mean(0), sure),
            "cut": lambda: (positions.detach(), sure.detach().requires_grad_()),
            "silent": lambda: (torch.nan_to_num(positions), torch.nan_to_num(sure)),
            "one": lambda: (positions[:, :1], sure[:, :1]),
        }
        return changed.get(self.broken, lambda: (positions, sure))()


@pytest.mark.parametrize("broken", ["pixels", "sure", "company", "cut", "silent", "one"])
def test_a_broken_readout_is_refused(broken: str) -> None:
    check_readout(BrokenReadout(""))
    with pytest.raises(CheckFailed):
        check_readout(BrokenReadout(broken))


def unseeded() -> Any:
    scene = gravity()
    drawn = torch.Generator().manual_seed(3)
    return replace(scene, sample=lambda n, rng: scene.sample(n, drawn))


def repelling() -> Any:
    return gravity(coupling=(-1.0, -0.5))


def heated() -> Any:
    return replace(gravity(), max_drift=1e-15)


class Turned(Hamiltonian):
    def force(self, state: PhaseState, params: Parameters) -> Tensor:
        return -super().force(state, params)


def turned() -> Any:
    return replace(gravity(), law=Turned(FixedKinetic(), SoftenedGravity(0.1)))


class Weightless(Scene):
    def derivatives(self, states: PhaseState, params: Parameters) -> PhaseState:
        return PhaseState(states.p, super().derivatives(states, params).p)


def weightless() -> Any:
    scene = gravity()
    return Weightless(**{f.name: getattr(scene, f.name) for f in fields(scene)})


@pytest.mark.parametrize(
    ("factory", "said"),
    [
        (unseeded, "the same episodes of a seed"),
        (repelling, "couplings above 0"),
        (heated, "most episodes certified"),
        (turned, "minus the gradient of its energy"),
        (weightless, "the way of its first step"),
        (lambda: gravity(), "pickled for a worker"),
    ],
)
def test_a_broken_scene_is_refused(factory: Callable[[], Any], said: str) -> None:
    with pytest.raises(CheckFailed, match=said):
        check_scene(factory)


def read_broken(broken: str, path: Path, columns: Any, interval: float | None) -> Recording:
    if broken == "raises":
        assert path.stat().st_size > 20
    if broken == "invents" and path.stat().st_size < 40:
        return Recording(np.zeros((1, 2, 1, 2)), None)
    found = read_text(path, columns, interval)
    if broken == "frames":
        return replace(found, positions=found.positions[0])
    if broken == "times":
        return replace(found, times=found.times[:, ::-1])  # type: ignore[index]
    return found


@pytest.mark.parametrize("broken", ["raises", "invents", "frames", "times"])
def test_a_broken_format_is_refused(broken: str, tmp_path: Path) -> None:
    path = files(tmp_path)["csv"]
    check_format(TrackFormat((".csv",), partial(read_broken, "")), path)
    with pytest.raises(CheckFailed):
        check_format(TrackFormat((".csv",), partial(read_broken, broken)), path)
    with pytest.raises(CheckFailed, match="lower case"):
        check_format(TrackFormat((".CSV",), read_text), path)


def test_checks_leave_what_they_check_as_it_was() -> None:
    head = Hamiltonian(FixedKinetic(), SoftenedGravity(0.3))
    before = copy.deepcopy(head.state_dict())
    check_head(head, params=law(3, plain=True), start=episodes(3, 2))
    assert all(torch.equal(before[key], value) for key, value in head.state_dict().items())
