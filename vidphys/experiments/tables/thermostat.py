"""Heat baths: does a model come to the right temperature, can it inject, does noise matter?"""

from __future__ import annotations

from collections.abc import Sequence

from dynamics import HamiltonianTerms, Head, Terms
from dynamics.bath import DiagonalBath
from dynamics.build import DiffusionTerms, to_config
from dynamics.hamiltonian import Hamiltonian
from vidphys import metrics
from vidphys.experiments.bath import bath_of, train_stochastic
from vidphys.experiments.tables.base import Cell, CellTask, Table
from vidphys.experiments.temperature import (
    WALKERS,
    Setting,
    Walkers,
    score_injection,
    score_temperatures,
    walkers,
)
from vidphys.records import Recorder
from vidphys.scenes import certify, lyapunov_time
from vidphys.scenes.langevin import BATHS, TRAP, BathScene, langevin

WIDTH = 16
OBSERVED = 500_000  # steps of training data over all trajectories
SETTINGS: tuple[Setting, ...] = tuple({"friction": g, "temperature": t} for g, t in BATHS)
INVERTED_FROM = SETTINGS[1:2]  # the bath whose friction is then turned around
NOISES = (0.01, 0.1, 0.3)


def in_bath(*ports: str) -> HamiltonianTerms:
    """A learned radial pair law in the known trap, with the given ports."""
    return HamiltonianTerms(potential="radial", trap=TRAP, width=WIDTH, ports=ports)


TERMS: dict[str, Terms] = {
    "guarantee": in_bath("bath"),
    "full": in_bath("full-bath"),
    "factored": in_bath("factored-bath"),
    "untied": in_bath("untied-bath"),
    "reversible": in_bath(),
    "neural-sde": DiffusionTerms(),
}


def part_name(setting: Setting) -> str:
    """What a bath is called in the records."""
    return f"gamma{setting['friction']:g}-T{setting['temperature']:g}"


def thermostat_cell(name: str) -> Cell:
    """A cell that trains one head in all baths and asks for temperature and injection."""

    def run(task: CellTask) -> None:
        scene = langevin()
        recorders = {seed: task.recorder(seed, scene, name) for seed in task.seeds}
        heads = train_stochastic(name, TERMS[name], scene, task, recorders, OBSERVED)
        for seed, head in heads.items():
            score_temperatures(
                recorders[seed], _parts(task, seed, name), head, scene, _crowd(task, scene, seed)
            )
            score_injection(recorders[seed], head, scene, _settling(task, scene, seed))

    return run


def _parts(task: CellTask, seed: int, name: str) -> list[tuple[Recorder, float | None]]:
    scene = langevin()
    return [(task.recorder(seed, scene, name, part_name(s)), None) for s in SETTINGS]


def _crowd(task: CellTask, scene: BathScene, seed: int) -> Walkers:
    return walkers(scene, SETTINGS, WALKERS * task.sizes.held_out, seed)


def _settling(task: CellTask, scene: BathScene, seed: int) -> Walkers:
    return walkers(scene, INVERTED_FROM, task.sizes.held_out, seed)


def simulator(task: CellTask) -> None:
    """The reference itself: its temperature against T, its injection, its certificates."""
    scene = langevin()
    for seed in task.seeds:
        recorder = task.recorder(seed, scene, "simulator")
        expected = [setting["temperature"] for setting in SETTINGS]
        crowd = _crowd(task, scene, seed)
        score_temperatures(
            recorder, _parts(task, seed, "simulator"), scene.exact, scene, crowd, expected
        )
        score_injection(recorder, scene.exact, scene, _settling(task, scene, seed))
        certify_bath(recorder, scene, _settling(task, scene, seed))


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
    recorder.add_value("lyapunov_time", float(time.median()))


def noise_cell(name: str, levels: Sequence[float] = NOISES) -> Cell:
    """A cell that trains one head on states seen with noise and asks for its temperature."""

    def run(task: CellTask) -> None:
        scene = langevin()
        for level in levels:
            part = f"noise{level:g}"
            recorders = {seed: task.recorder(seed, scene, name, part) for seed in task.seeds}
            heads = train_stochastic(name, TERMS[name], scene, task, recorders, OBSERVED, level)
            for seed, head in heads.items():
                recorder, crowd = recorders[seed], _crowd(task, scene, seed)
                parts = [
                    (task.recorder(seed, scene, name, f"{part}/{part_name(s)}"), None)
                    for s in SETTINGS
                ]
                score_temperatures(recorder, parts, head, scene, crowd)
                recorder.add_value("friction_ratio", friction_ratio(head, crowd))

    return run


def friction_ratio(head: Head, crowd: Walkers) -> float:
    """Learned friction over the true one, averaged over walkers and coordinates."""
    bath = bath_of(head) if isinstance(head, Hamiltonian) else None
    assert isinstance(bath, DiagonalBath)
    true = crowd.params.scalar("friction")[:, None, None]
    return float((bath.friction(crowd.params).detach() / true).mean())


THERMOSTAT = Table(
    name="thermostat",
    title="Thermostat: which structures come to the right temperature, and which can inject?",
    about=(
        "Three bodies that attract each other in a trap, in four heat baths, started hot. The "
        "temperature that a long rollout settles at, against the simulator's own, and the energy "
        "that a model gains when the friction it is told turns negative. Baths are told friction "
        "and temperature; the energy is not conserved, so there is no drift column."
    ),
    ids="N44",
    cells={"simulator": simulator, **{name: thermostat_cell(name) for name in TERMS}},
    settings={
        "scene": langevin().settings,
        "heads": {name: to_config(terms) for name, terms in TERMS.items()},
        "observed_steps": OBSERVED,
    },
)
MEASUREMENT_NOISE = Table(
    name="measurement-noise",
    title="Thermostat trained on noisy states",
    about=(
        "The same baths, learned from states that a sensor reports with noise of a part of their "
        "spread. Beside the temperature stands what it hides: the friction that was learned."
    ),
    ids="N45",
    cells={name: noise_cell(name) for name in ("guarantee", "untied")},
    settings={"noises": list(NOISES), "observed_steps": OBSERVED},
)
