"""Rollouts are never silently wrong: pieces of steps, named warnings, refusals, status."""

from __future__ import annotations

import math
import warnings

import pytest
import torch
from torch import Tensor

from dynamics import (
    HEADS,
    DomainWarning,
    DynamicsWarning,
    EnergyWarning,
    FailureWarning,
    Hamiltonian,
    Parameters,
    PhaseState,
    RoundingWarning,
    StabilityWarning,
    build,
    kahan_li8,
    leapfrog,
    leapfrog_compensated,
    rk4,
    rollout,
    tao,
)
from dynamics.checks import energy_drift
from dynamics.contact import KnotPotential, SoftContact
from dynamics.domain import EXTENTS, extents, largest
from dynamics.fields import EllipticTrap
from dynamics.kinetic import FixedKinetic
from dynamics.pairs import MOST_PAIRS, Listed, pair_groups, pair_indices, pair_tiles
from dynamics.potentials import (
    HarmonicTrap,
    NoPotential,
    PairPotential,
    SoftenedGravity,
    SumPotential,
)
from dynamics.stability import SteepnessTable, flat_parameters, rates_of, steepness, stiffest
from dynamics.substeps import watched
from loops.threads import held_to

DT = 0.002


def pair(
    eccentricity: float, dtype: torch.dtype = torch.float64, batch: int = 0, apart: float = 1.0
) -> tuple[PhaseState, Parameters]:
    """Two unit masses at apocentre."""
    v = math.sqrt(2 * (1 - eccentricity) / apart) / 2
    q = torch.tensor([[apart / 2, 0.0], [-apart / 2, 0.0]], dtype=dtype)
    p = torch.tensor([[0.0, v], [0.0, -v]], dtype=dtype)
    params = Parameters(torch.ones((), dtype=dtype), torch.ones(2, dtype=dtype))
    state = PhaseState(q, p)
    if batch:
        state = state.map(lambda x: x.expand(batch, 2, 2).clone())
        params = Parameters(params.coupling.expand(batch), params.mass.expand(batch, 2))
    return state, params


def gravity(softening: float, integrator=leapfrog) -> Hamiltonian:  # noqa: ANN001
    return Hamiltonian(FixedKinetic(), SoftenedGravity(softening), integrator)


def quietly(*arguments, **options):  # noqa: ANN002, ANN003, ANN202
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return rollout(*arguments, **options)


def plain(head, state: PhaseState, params: Parameters, steps: int, dt: float) -> PhaseState:  # noqa: ANN001
    stored, memory = [state], None
    with torch.no_grad():
        for _ in range(steps):
            state, memory = head.advance(state, params, dt, memory)
            stored.append(state)
    return PhaseState.stack(stored, -3)


# --- the estimate -------------------------------------------------------------------------------


def test_the_rate_of_two_bodies_is_that_of_their_small_oscillation() -> None:
    state, params = pair(0.0)
    near = PhaseState(1e-4 * state.q, state.p)
    rates = rates_of(gravity(0.01), near, flat_parameters(params, torch.Size()))
    found = stiffest(rates, near.q.unsqueeze(0))
    assert float(found.rate) == pytest.approx(math.sqrt(2 / 0.01**3), rel=0.005)
    assert found.pair.tolist() == [[0, 1]] and found.term == "SoftenedGravity"


@pytest.mark.parametrize(
    ("potential", "r", "slope"),
    [
        (SoftenedGravity(1e-3), 0.5, 2 / 0.5**3),
        (SoftContact(0.5), 0.3, 1.0),
        (SoftContact(0.5), 1e-7, 1.0),  # the cone's tip is not a stiffness
        (SoftContact(0.5), 0.7, 0.0),
    ],
)
def test_steepness_is_the_slope_of_the_force_at_the_distance_or_beyond(potential, r, slope) -> None:
    table = SteepnessTable(potential, torch.zeros(2, 2, dtype=torch.float64))
    found = float(table.at(torch.tensor([r * r], dtype=torch.float64)))
    assert slope * 0.99 <= found <= slope * 1.2  # the cells of the table are 6 % wide


def test_a_learned_table_is_kept_until_a_weight_changes() -> None:
    torch.manual_seed(0)
    potential, like = build(HEADS["factored"], 3, DT).potential, torch.zeros(2, 2)  # type: ignore[union-attr]
    before = steepness(potential, like)
    assert steepness(potential, like) is before
    last = potential.phi.layers[-1].weight  # type: ignore[union-attr]
    with torch.no_grad():
        last.mul_(2)
    twice = steepness(potential, like)
    assert torch.allclose(twice.values, 2 * before.values)
    last.data.mul_(2)  # not counted by torch
    assert torch.allclose(steepness(potential, like).values, 4 * before.values)


def test_the_stiffest_pair_and_term_are_named() -> None:
    q = torch.tensor([[0.0, 0.0], [3.0, 0.0], [3.05, 0.0]], dtype=torch.float64)
    state = PhaseState(q, torch.zeros_like(q))
    params = Parameters(torch.tensor(1e6).double(), torch.ones(3).double())
    model = SumPotential([SoftContact(0.5), HarmonicTrap(1.0)])
    head = Hamiltonian(FixedKinetic(), model)
    with pytest.warns(StabilityWarning, match=r"SoftContact of bodies 1 and 2 at step 0"):
        run = rollout(head, state, params, 1, DT, substeps=False)
    finding = next(f for f in run.findings if f.kind is StabilityWarning)
    assert (finding.step, finding.body, finding.term) == (0, 1, "SoftContact")
    assert run.status == "warned"


def test_what_a_step_always_resolves_is_not_watched() -> None:
    state, params = pair(0.9)
    assert not watched(gravity(0.1), state, params, DT)
    assert watched(gravity(0.01), state, params, DT)


# --- pieces of steps ----------------------------------------------------------------------------


@pytest.mark.parametrize("softening", [1e-1, 1e-3])
def test_resolved_steps_are_the_integrators_own_bit_for_bit(softening: float) -> None:
    state, params = pair(0.0)
    head = gravity(softening)
    run = quietly(head, state, params, 200, DT)
    assert run.pieces == 0 and run.status == "ok"
    assert torch.equal(run.states.flat, plain(head, state, params, 200, DT).flat)


def test_only_the_episode_that_needs_it_is_taken_in_pieces() -> None:
    state, params = pair(0.0, batch=3, apart=0.3)
    state.p[1] = 0  # falls
    head = gravity(1e-3)
    run = quietly(head, state, params, 80, DT)
    assert run.pieces > 0
    alone = plain(head, state, params, 80, DT)
    for episode in (0, 2):
        assert torch.equal(run.states.flat[episode], alone.flat[episode])
    assert float(energy_drift(head, run.states, params).max()) < 1e-2
    assert float(energy_drift(head, alone, params).max()) > 1


@pytest.mark.parametrize(("integrator", "bound"), [(leapfrog, 1e-2), (kahan_li8, 1e-6)])
def test_a_plunge_keeps_its_energy(integrator, bound: float) -> None:  # noqa: ANN001
    state, params = pair(1.0, apart=0.3)
    run = quietly(gravity(1e-3, integrator), state, params, 80, DT)
    assert float(energy_drift(gravity(1e-3), run.states, params).max()) < bound


def test_pieces_retrace_their_way() -> None:
    state, params = pair(0.99, apart=0.3)
    head = gravity(1e-3)
    there = quietly(head, state, params, 80, DT)
    back = quietly(head, there.at(-1).reversed, params, 80, DT)
    assert there.pieces == back.pieces > 0
    assert float((back.at(-1).reversed.flat - state.flat).abs().max()) < 1e-11


def test_a_stiff_contact_is_resolved_where_it_touches() -> None:
    state, params = pair(0.0)
    state = PhaseState(state.q, torch.tensor([[-1.0, 0], [1.0, 0]], dtype=torch.float64))
    head = Hamiltonian(FixedKinetic(), SoftContact(0.5))
    run = quietly(head, state, params.with_coupling(1e6), 200, DT)
    assert float(energy_drift(head, run.states, params.with_coupling(1e6)).max()) < 1e-3


def test_a_fast_pass_is_not_jumped_over() -> None:
    q = torch.tensor([[-0.5, 0.0], [0.5, 1e-3]], dtype=torch.float64)
    p = torch.tensor([[50.0, 0.0], [-50.0, 0.0]], dtype=torch.float64)
    _, params = pair(0.0)
    heavy = Parameters(params.coupling * 2000, params.mass)
    run = rollout(gravity(1e-3), PhaseState(q, p), heavy, 10, DT)
    fine = rollout(gravity(1e-3, kahan_li8), PhaseState(q, p), heavy, 100, DT / 10)
    assert float((run.at(-1).p - fine.at(-1).p).abs().max()) < 5e-9 * float(fine.at(-1).p.norm())


def test_a_step_that_cannot_be_resolved_says_so() -> None:
    state, params = pair(0.0)
    stiff = ((1.0, 0.0), (0.0, 1e12))
    for trap in (HarmonicTrap(1e12), EllipticTrap(stiff, (0.0, 0.0))):
        name = type(trap).__name__
        head = Hamiltonian(FixedKinetic(), trap)
        with pytest.warns(StabilityWarning, match=f"{name} turns by"):
            run = rollout(head, state, params, 1, DT)
        assert run.status == "warned"


def test_methods_that_cannot_start_anew_are_warned_of() -> None:
    state, params = pair(0.0, apart=0.01)
    with pytest.warns(StabilityWarning, match="SoftenedGravity of bodies 0 and 1 at step 0"):
        rollout(gravity(1e-3, tao), state, params, 2, DT)


# --- pairs in bounded memory --------------------------------------------------------------------


def test_tiles_hold_each_pair_once() -> None:
    device = torch.device("cpu")
    tiles = list(pair_tiles(3000, 1, device))
    assert len(tiles) > 2
    assert max(len(i) for i, _ in tiles) <= 2**20
    assert sum(len(i) for i, _ in tiles) == 3000 * 2999 // 2
    code = torch.cat([i * 3000 + j for i, j in tiles])
    assert len(code.unique()) == len(code) and all(bool((i < j).all()) for i, j in tiles)


@pytest.mark.parametrize("tile", [1000, 2**20])
def test_forces_and_energies_in_blocks_are_those_of_all_pairs_at_once(
    tile: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = torch.Generator().manual_seed(0)
    q = torch.randn(2, 300, 2, generator=rng, dtype=torch.float64).requires_grad_()
    params = Parameters(torch.tensor(1.3).double(), torch.rand(300, generator=rng).double())
    law, listed = SoftenedGravity(0.1), torch.triu_indices(300, 300, offset=1)
    monkeypatch.setattr("dynamics.pairs.TILE", tile)
    force, energy = law.force(q, params), law.energy(q, params)
    at_once = Listed(listed[0], listed[1])
    phi = (at_once.product(params.mass) * law.pair_energy(at_once.difference(q))).sum(-1)
    (slope,) = torch.autograd.grad(energy.sum(), q)
    assert torch.allclose(energy, params.coupling * phi, rtol=1e-13)
    assert torch.allclose(force, -slope, rtol=1e-12, atol=1e-12)
    assert force.sum(-2).abs().max() < 1e-10 * force.abs().max()


def test_groups_hold_each_pair_once() -> None:
    device, bodies = torch.device("cpu"), 300
    count = torch.zeros(bodies, bodies, dtype=torch.long)
    groups = list(pair_groups(bodies, 1, device))
    for pairs in groups:
        if isinstance(pairs, Listed):
            count[pairs.first, pairs.second] += 1
        else:
            count[pairs.rows, pairs.columns] += 1
    assert len(groups) == 6 and torch.equal(count, torch.ones_like(count).triu(1))


def test_too_many_pairs_at_once_are_refused_before_they_are_allocated() -> None:
    with pytest.raises(ValueError, match="10000 bodies make 49,995,000 pairs"):
        pair_indices(10_000, torch.device("cpu"))
    assert MOST_PAIRS < 10_000 * 9_999 // 2


# --- precision, finiteness, status --------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_half_precision_is_refused(dtype: torch.dtype) -> None:
    state, params = pair(0.0)
    with pytest.raises(ValueError, match="too coarse to integrate"):
        rollout(gravity(0.1), state.map(lambda x: x.to(dtype)), params, 1, DT)


def test_other_bodies_episodes_and_precisions_are_refused_in_our_words() -> None:
    head = build(HEADS["factored"], bodies=3, dt=DT)
    state = PhaseState(torch.randn(2, 3, 2), torch.zeros(2, 3, 2))
    law = Parameters(torch.ones(2), torch.ones(2, 3))
    assert bool(rollout(head, state, law, 2, DT).finite.all())
    double, few = state.map(Tensor.double), Parameters(torch.ones(2), torch.ones(2, 2))
    for start, params, words in (
        (state, few, r"mass is \(2, 2\), but a state of 3 bodies \(2, 3, 2\) needs \(2, 3\)"),
        (state, Parameters(torch.ones(3), torch.ones(3, 3)), r"mass is \(3, 3\)"),
        (double, law, "networks of Hamiltonian are float32, the state is float64"),
        (state, law.map(Tensor.double), "the coupling is float64"),
    ):
        with pytest.raises(ValueError, match=words):
            rollout(head, start, params, 2, DT)


@pytest.mark.parametrize("name", ["coupling", "mass", "friction"])
def test_parameters_that_are_not_finite_are_named(name: str) -> None:
    state, params = pair(0.0, batch=3)
    params = params.with_scalar("friction", 0.1).map(Tensor.clone)
    where = {"coupling": params.coupling, "mass": params.mass, **params.scalars}[name]
    where[1] = math.nan
    with pytest.raises(ValueError, match=rf"{name}\[1.*not finite"):
        rollout(gravity(0.1), state, params, 1, DT)


class Spoiled(PairPotential):
    """A force that is not a number beyond one world unit."""

    def pair_energy(self, displacement: Tensor) -> Tensor:
        return displacement.square().sum(-1)

    def pair_gradient(self, displacement: Tensor) -> Tensor:
        r = displacement.norm(dim=-1, keepdim=True)
        return torch.where(r > 1.0, torch.nan, -displacement)


@pytest.mark.parametrize("every", [1, 50])
def test_a_failure_names_step_body_and_term(every: int) -> None:
    state, params = pair(0.0)
    state = PhaseState(0.99 * state.q, 0.1 * state.q)
    head = Hamiltonian(FixedKinetic(), SumPotential([NoPotential(), Spoiled()]))
    with pytest.warns(FailureWarning, match="body 0, by Spoiled"):
        run = rollout(head, state, params, 100, DT, every)
    assert run.status == "failed"
    finding = run.findings[0]
    q = rollout(head, state, params, finding.step - 1, DT).at(-1).q
    assert finding.term == "Spoiled" and bool(torch.isfinite(q).all())
    assert 1 < finding.step < 100


def test_energy_that_is_lost_is_said() -> None:
    state, params = pair(1.0, apart=0.3)
    with pytest.warns(EnergyWarning, match="although the model conserves it"):
        run = rollout(gravity(0.05), state, params, 80, DT, substeps=False)
    assert run.status == "warned"


def test_energy_is_not_asked_of_models_that_do_not_conserve_it() -> None:
    state, params = pair(0.0)
    head = build(HEADS["unstructured"], 2, DT).double()
    assert quietly(head, state, params, 20, DT).status == "ok"
    assert not head.conserves


@pytest.mark.parametrize(("episodes", "wanted"), [(8, 1), (4096, 2)])
def test_one_thread_looks_at_the_energy_of_a_few_states(episodes: int, wanted: int) -> None:
    head, seen = gravity(0.05), []
    state, params = pair(0.0, batch=episodes)
    asked = head.energy
    head.energy = lambda *given: seen.append(torch.get_num_threads()) or asked(*given)  # type: ignore[func-returns-value, method-assign]
    with held_to(2):
        rollout(head, state, params, 4, DT)
        assert torch.get_num_threads() == 2
    assert seen == [wanted]


# --- where a learned model was trained ----------------------------------------------------------


@pytest.mark.parametrize("bodies", [1, 3, 9])
@pytest.mark.parametrize("box", [None, 2.0])
def test_the_largest_extents_of_a_rollout_are_those_of_its_states(bodies: int, box) -> None:  # noqa: ANN001
    state = PhaseState(*torch.randn(2, 4, 5, bodies, 2).double())
    whole = extents(state, box).reshape(-1, len(EXTENTS)).amax(0)
    found = largest(state, EXTENTS, box)
    assert list(found.values()) == pytest.approx(whole.tolist(), rel=3e-15)


@pytest.mark.parametrize("name", HEADS.ours())
def test_states_far_outside_training_are_said(name: str) -> None:
    torch.manual_seed(0)
    rng = torch.Generator().manual_seed(0)
    q, p = (torch.randn(50, 3, 2, generator=rng) for _ in range(2))
    params = Parameters(torch.ones(50), torch.ones(50, 3))
    head = build(HEADS[name], 3, DT)
    head.set_scale(1e-3, 1e-3)
    far = PhaseState(100 * q, 100 * p)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DomainWarning)
        rollout(head, far, params, 2, DT)  # nothing is known of its training
        head.see(PhaseState(q, p))
        rollout(head, PhaseState(q, p), params, 2, DT)
    with pytest.warns(DomainWarning, match="more than 3 times the largest of its training"):
        rollout(head, far, params, 2, DT)


@pytest.mark.parametrize(("away", "kinds"), [(10.0, set()), (2e4, {RoundingWarning})])
def test_positions_too_far_away_for_their_precision_are_said(away: float, kinds: set) -> None:
    """At 2e4 world units a step is 0.7 of what float32 can tell apart."""
    state, params = pair(0.0, torch.float32)
    head = Hamiltonian(FixedKinetic(), NoPotential())
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        rollout(head, PhaseState(state.q + away, state.p), params, 100, DT)
        rollout(head, PhaseState(state.q + away, 0 * state.p), params, 100, DT)  # nothing moves
    assert {w.category for w in caught} == kinds
    assert len(caught) == len(kinds)


def test_the_domain_is_part_of_the_weights_and_old_weights_load() -> None:
    state, _ = pair(0.0, torch.float32)
    one, other = (build(HEADS["factored"], 2, DT) for _ in range(2))
    one.see(state)
    weights = one.state_dict()
    other.load_state_dict(weights)
    assert torch.equal(other.domain, one.domain)
    del weights["domain"]
    other.load_state_dict(weights)
    assert bool(torch.isinf(other.domain).all())


# --- compensated sums ---------------------------------------------------------------------------


def test_compensated_sums_lose_less() -> None:
    exact, params = pair(0.2)
    single, law = pair(0.2, torch.float32)
    far = {}
    reference = rollout(gravity(0.1), exact, params, 2000, DT).at(-1)
    for method in (leapfrog, leapfrog_compensated):
        end = rollout(gravity(0.1, method), single, law, 2000, DT).at(-1)
        far[method.name] = float((end.flat.double() - reference.flat).abs().max())
    assert far["leapfrog_compensated"] < 0.2 * far["leapfrog"]


def test_all_findings_are_dynamics_warnings() -> None:
    kinds = (StabilityWarning, EnergyWarning, DomainWarning, FailureWarning)
    assert all(issubclass(kind, DynamicsWarning) for kind in kinds)
    assert rk4.restarts and not leapfrog_compensated.restarts
    assert KnotPotential(3, 0.5).law.box is None
