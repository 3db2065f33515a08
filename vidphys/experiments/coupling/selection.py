"""Which measurements leave exactly one power of the coupling."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Generator, Tensor

from dynamics import PhaseState, Rollout
from vidphys import metrics
from vidphys.coupling_power import Forces, coupling_power, measured_forces
from vidphys.coupling_verdict import CANDIDATES, SUPPORTED, PowerVerdict
from vidphys.experiments.core.cell import CellTask, Table
from vidphys.scenes import certify
from vidphys.scenes.changed_laws import gravity_of_power
from vidphys.seeding import derive

TRIALS = 50  # of each of the four worlds
RECORDED = 32  # episodes of a trial, all at G > 0
STEPS, EVERY = 80, 4  # reference steps of an episode, and between recorded states
FIXED = -1.0
DOMAIN = (-1.5, 1.5)  # of the query that does not look at the data
NOISES = {"clean": 0.0, "noisy": 0.003}  # of the state's standard deviation
ONE_QUERY = 1

Query = Callable[[PowerVerdict, Generator], float | None]
QUERIES: dict[str, Query] = {
    "positive-only": lambda verdict, rng: None,
    "fixed": lambda verdict, rng: FIXED,
    "full-domain": lambda verdict, rng: float(
        torch.empty((), dtype=torch.float64).uniform_(*DOMAIN, generator=rng)
    ),
    "named": lambda verdict, rng: verdict.query,
}


def run_selection(task: CellTask) -> None:
    """Trials in the four worlds; each query is one more episode, asked of the world itself."""
    for seed in task.seeds:
        for world in CANDIDATES:
            _certify(task, world, seed)
        for noise_name, noise in NOISES.items():
            verdicts: dict[str, list[tuple[str, PowerVerdict]]] = {name: [] for name in QUERIES}
            for world in CANDIDATES:
                for name, some in _trials(world, noise, derive(seed, noise_name, world)).items():
                    verdicts[name] += [(world, verdict) for verdict in some]
            for name, found in verdicts.items():
                _record(task, seed, f"{noise_name}/{name}", found)


def _certify(task: CellTask, world: str, seed: int) -> None:
    """Whether such records are sound; their Lyapunov times stand with the misspecification."""
    scene = gravity_of_power(world)
    start, params = scene.sample(RECORDED, Generator().manual_seed(derive(seed, "truth")))
    proof = certify(scene, scene.simulate(start, params, STEPS, EVERY))
    recorder = task.recorder(seed, scene, "truth", f"truth/{world}")
    recorder.add("certified_fraction", metrics.mean(proof.passed.double()))
    recorder.add("reference_drift_worst", metrics.worst(proof.drift), None, STEPS)
    recorder.add_value("closest_approach", float(proof.closest.min()))


def _trials(world: str, noise: float, seed: int) -> dict[str, list[PowerVerdict]]:
    rng = Generator().manual_seed(seed)
    recorded = measured_world(world, TRIALS * RECORDED, None, noise, rng)
    before = [coupling_power(_part(recorded, trial)) for trial in range(TRIALS)]
    found: dict[str, list[PowerVerdict]] = {}
    for name, query in QUERIES.items():
        at = [query(verdict, rng) for verdict in before]
        asked = torch.tensor([1.0 if g is None else g for g in at], dtype=torch.float64)
        answers = measured_world(world, TRIALS, asked, noise, rng)
        found[name] = [
            verdict
            if at[i] is None
            else coupling_power(_part(recorded, i).joined(_part(answers, i, ONE_QUERY)))
            for i, verdict in enumerate(before)
        ]
    return found


def measured_world(
    world: str, episodes: int, coupling: Tensor | None, noise: float, rng: Generator
) -> Forces:
    """Forces measured in a world, at couplings that were drawn (G > 0) or are asked for."""
    scene = gravity_of_power(world)
    start, params = scene.sample(episodes, rng)
    if coupling is not None:
        params = params.with_coupling(coupling)
    return measured_forces(_seen(scene.simulate(start, params, STEPS, EVERY), noise, rng))


def _seen(path: Rollout, noise: float, rng: Generator) -> Rollout:
    """The states with independent errors, a share of the standard deviation of q and of p."""

    def blurred(x: Tensor) -> Tensor:
        return x + noise * x.std() * torch.randn(x.shape, generator=rng, dtype=x.dtype)

    return replace(path, states=PhaseState(blurred(path.states.q), blurred(path.states.p)))


def _part(forces: Forces, index: int, size: int = RECORDED) -> Forces:
    chosen = slice(index * size, (index + 1) * size)
    return Forces(
        forces.state[chosen], forces.force[chosen], forces.coupling[chosen], forces.mass[chosen]
    )


def _record(task: CellTask, seed: int, part: str, found: list[tuple[str, PowerVerdict]]) -> None:
    """Shares of trials."""

    def share(metric: str, holds: list[bool]) -> None:
        values = torch.tensor(holds, dtype=torch.float64)
        recorder.add(metric, metrics.mean(values))
        recorder.add_episodes(metric, values)

    recorder = task.recorder(seed, gravity_of_power("linear"), "coupling-power", part)
    alone = [verdict.supported == (world,) for world, verdict in found]
    wrong = [bool(v.supported) and world not in v.supported for world, v in found]
    share("unique_selection", alone)
    share("wrong_selection", wrong)
    others = [verdict for world, verdict in found if world != "linear"]
    share("linear_prior_warned", [verdict.of("linear") != SUPPORTED for verdict in others])
    pair = [v for world, v in found if world in ("linear", "even")]
    share("sign_abstained", [len(verdict.supported) != 1 for verdict in pair])
    share("query_named", [verdict.query is not None for verdict in pair])


SELECTION = Table.told(
    "selection",
    cells={"gravity": run_selection},
    settings={"trials": TRIALS * len(CANDIDATES), "recorded": RECORDED, "noises": NOISES},
)
