"""A drive against the friction: the steady state at trained and unseen strengths, and beyond."""

from __future__ import annotations

from collections.abc import Sequence

from dynamics import terms, to_config
from dynamics.bath import steady_temperature
from dynamics.terms import HeadTerm
from vidphys.experiments.core.cell import Cell, CellTask, Table
from vidphys.experiments.heat.bath import train_stochastic
from vidphys.experiments.heat.temperature import (
    WALKERS,
    Setting,
    Walkers,
    known,
    score_growth,
    score_temperatures,
    simulated,
    walkers,
)
from vidphys.experiments.heat.thermostat import certify_bath, in_bath
from vidphys.scenes.langevin import DRIVEN_BATH, BathScene, driven

FRICTION, TEMPERATURE = DRIVEN_BATH
ASKED = (-1.0, 0.0, 0.25, 0.5, 1.0, 1.4)  # A per second; 0, 0.5 and 1 are trained
BEYOND = (2.0, 2.5, 3.0)  # A >= friction: no steady state
OBSERVED = 4_000_000  # steps: T_eff at A = 1.4 shows an error of the drive 2.3 times over

TERMS: dict[str, HeadTerm] = {
    "factored-drive": in_bath(terms.DrivenBath()),
    "control": in_bath(terms.ConstantBath()),
    "unstructured": terms.Diffusion(),
}


def _settings(drives: Sequence[float]) -> list[Setting]:
    return [{"friction": FRICTION, "temperature": TEMPERATURE, "drive": a} for a in drives]


def _crowds(task: CellTask, scene: BathScene, seed: int) -> tuple[Walkers, Walkers]:
    """Walkers under the drives that have a steady state, and under those that have none."""
    held_out = task.sizes.held_out
    steady = walkers(scene, _settings(ASKED), WALKERS * held_out, seed)
    return steady, walkers(scene, _settings(BEYOND), WALKERS // 4 * held_out, seed)


def drive_cell(name: str) -> Cell:
    """A cell that trains one head at three drives and asks for six, and for those beyond."""

    def run(task: CellTask) -> None:
        scene = driven()
        trained = train_stochastic(name, TERMS[name], scene, task, OBSERVED)
        for seed, head, recorder in trained:
            steady, beyond = _crowds(task, scene, seed)
            parts = [(recorder, drive) for drive in ASKED]
            truth = simulated(scene, steady, seed)
            score_temperatures(recorder, parts, head, scene, steady, truth)
            score_growth(recorder, head, scene, beyond, steady)

    return run


def simulator(task: CellTask) -> None:
    """The reference itself: its temperature against theory, growth, and certificates."""
    scene = driven()
    for seed in task.seeds:
        recorder = task.recorder(seed, scene, "simulator")
        steady, beyond = _crowds(task, scene, seed)
        theory = known(steady_temperature(steady.params)[:: steady.each].tolist())
        parts = [(recorder, drive) for drive in ASKED]
        score_temperatures(recorder, parts, scene.exact, scene, steady, theory)
        score_growth(recorder, scene.exact, scene, beyond, steady)
        certify_bath(recorder, scene, walkers(scene, _settings(ASKED[:1]), task.sizes.held_out, 0))


DRIVE = Table.told(
    "drive",
    cells={"simulator": simulator, **{name: drive_cell(name) for name in TERMS}},
    settings={
        "scene": driven().settings,
        "heads": {name: to_config(term) for name, term in TERMS.items()},
        "observed_steps": OBSERVED,
        "asked": list(ASKED),
        "beyond": list(BEYOND),
    },
)
NO_STEADY_STATE = Table.told("no-steady-state")
