"""Heat baths: does a model come to the right temperature, can it inject, does noise matter?"""

from __future__ import annotations

from collections.abc import Sequence

from dynamics import Head, terms, to_config
from dynamics.bath import DiagonalBath
from dynamics.hamiltonian import Hamiltonian
from dynamics.terms import HeadTerm, PortTerm
from vidphys import metrics
from vidphys.experiments.core.cell import Cell, CellTask, Table
from vidphys.experiments.heat.bath import bath_of, train_stochastic
from vidphys.experiments.heat.temperature import (
    WALKERS,
    Setting,
    Walkers,
    known,
    score_injection,
    score_temperatures,
    simulated,
    walkers,
)
from vidphys.experiments.heat.thermal import Measured
from vidphys.runs.records import Recorder
from vidphys.scenes import certify, lyapunov_time
from vidphys.scenes.langevin import BATHS, TRAP, BathScene, langevin

WIDTH = 16
OBSERVED = 500_000  # steps of training data over all trajectories
SETTINGS: tuple[Setting, ...] = tuple({"friction": g, "temperature": t} for g, t in BATHS)
INVERTED_FROM = SETTINGS[1:2]  # the bath whose friction is then turned around
NOISES = (0.01, 0.1, 0.3)


def in_bath(*ports: PortTerm) -> HeadTerm:
    """A learned radial pair law in the known trap, with the given ports."""
    return terms.Hamiltonian(potentials=(terms.Radial(width=WIDTH), terms.Trap(TRAP)), ports=ports)


TERMS: dict[str, HeadTerm] = {
    "guarantee": in_bath(terms.Bath()),
    "full": in_bath(terms.FullBath()),
    "factored": in_bath(terms.FactoredBath()),
    "untied": in_bath(terms.UntiedBath()),
    "reversible": in_bath(),
    "neural-sde": terms.Diffusion(),
}


def part_name(setting: Setting) -> str:
    """What a bath is called in the records."""
    return f"gamma{setting['friction']:g}-T{setting['temperature']:g}"


def bath_cell(name: str, noise: float = 0.0) -> Cell:
    """A cell that trains one head in all baths and asks for temperature and injection.

    Args:
        name: of the head.
        noise: with which the states are seen that it learns from, as a part of their spread.
    """

    def run(task: CellTask) -> None:
        scene = langevin()
        trained = train_stochastic(name, TERMS[name], scene, task, OBSERVED, noise)
        for seed, head, recorder in trained:
            truth = simulated(scene, _crowd(task, scene, seed), seed)
            ask(task, recorder, head, scene, truth)

    return run


def simulator(task: CellTask) -> None:
    """The reference itself: its temperature against T, its injection, its certificates."""
    scene = langevin()
    theory = known([setting["temperature"] for setting in SETTINGS])
    for seed in task.seeds:
        recorder = task.recorder(seed, scene, "simulator")
        ask(task, recorder, scene.exact, scene, theory)
        certify_bath(recorder, scene, _settling(task, scene, seed))


def ask(
    task: CellTask, recorder: Recorder, head: Head, scene: BathScene, truth: Sequence[Measured]
) -> None:
    """Temperature in each bath, injection, and the friction that was learned."""
    seed, crowd = recorder.origin.seed, _crowd(task, scene, recorder.origin.seed)
    names = [part_name(setting) for setting in SETTINGS]
    parts = [(task.recorder(seed, scene, recorder.origin.head, name), None) for name in names]
    score_temperatures(recorder, parts, head, scene, crowd, truth)
    score_injection(recorder, head, scene, _settling(task, scene, seed))
    bath = bath_of(head) if isinstance(head, Hamiltonian) else None
    if isinstance(bath, DiagonalBath):
        true = crowd.params.scalar("friction")[:, None, None]
        ratio = bath.friction(crowd.params).detach() / true
        recorder.add_value("friction_ratio", float(ratio.mean()))


def _crowd(task: CellTask, scene: BathScene, seed: int) -> Walkers:
    return walkers(scene, SETTINGS, WALKERS * task.sizes.held_out, seed)


def _settling(task: CellTask, scene: BathScene, seed: int) -> Walkers:
    return walkers(scene, INVERTED_FROM, task.sizes.held_out, seed)


CERTIFIED_STEPS = 200
LYAPUNOV_ROUNDS, LYAPUNOV_STEPS = 40, 20


def certify_bath(recorder: Recorder, scene: BathScene, crowd: Walkers) -> None:
    """Certificates of the scene's episodes, energy checked with the bath switched off."""
    isolated = crowd.params
    for name in ("friction", "temperature", "drive"):
        if name in isolated.scalars:
            isolated = isolated.with_scalar(name, 0.0)
    quiet = scene.simulate(crowd.start, isolated, CERTIFIED_STEPS, 5)
    noisy = scene.simulate(crowd.start, crowd.params, CERTIFIED_STEPS, 5, recorder.origin.seed)
    proof = certify(scene, quiet)
    passed = proof.passed & certify(scene, noisy, conserving=False).passed
    recorder.add_value("certified_fraction", float(passed.double().mean()))
    recorder.add("reference_drift_median", metrics.median(proof.drift), None, CERTIFIED_STEPS)
    recorder.add("reference_drift_worst", metrics.worst(proof.drift), None, CERTIFIED_STEPS)
    recorder.add_value("closest_approach", float(proof.closest.min()))
    time = lyapunov_time(scene, crowd.start, isolated, LYAPUNOV_ROUNDS, LYAPUNOV_STEPS)
    recorder.add_value("lyapunov_time", float(time.quantile(0.5)))


THERMOSTAT = Table.told(
    "thermostat",
    cells={"simulator": simulator, **{name: bath_cell(name) for name in TERMS}},
    settings={
        "scene": langevin().settings,
        "heads": {name: to_config(term) for name, term in TERMS.items()},
        "observed_steps": OBSERVED,
    },
)
MEASUREMENT_NOISE = Table.told(
    "measurement-noise",
    cells={
        f"{name}/noise{level:g}": bath_cell(name, level)
        for name in ("guarantee", "untied")
        for level in NOISES
    },
    settings={"observed_steps": OBSERVED},
)
