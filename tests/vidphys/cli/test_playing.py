"""The law that a report's page rolls is that of the Python rollout, to 1e-5."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch

import viz
from dynamics import HEADS, Hamiltonian, Parameters, PhaseState, build
from dynamics.friction import Friction
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import SoftenedGravity
from vidphys.cli import playing

NODE = shutil.which("node")
SCRIPT = (Path(viz.__file__).parent / "templates" / "law.js").read_text()
ASK = """
const told = JSON.parse(require("fs").readFileSync(0, "utf8")), law = told.law;
const gradient = told.true ? trueGradient(law) : splineGradient(law);
console.log(JSON.stringify(roll(gradient, law, told.asked)));
"""


@pytest.fixture(scope="module")
def played():
    """An untrained law, whose force is as good as any to be held to."""
    torch.manual_seed(0)
    head = build(HEADS["factored"], bodies=3, dt=0.002)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(playing, "STEPS", 200)
        patch.setattr(playing, "STARTS", 8)
        yield head, json.loads(json.dumps(playing.law_to_play(head)))


def by_script(law, asked, true=False):
    done = subprocess.run(
        [NODE, "-e", SCRIPT.replace('"use strict";', "") + ASK],
        input=json.dumps({"law": law, "asked": asked, "true": true}),
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    return np.array(json.loads(done.stdout))


def by_python(potential, law, asked):
    friction = Friction("linear", "known")
    head = Hamiltonian(FixedKinetic(), potential, ports=[friction]).double()
    q, p = (torch.tensor(law[name], dtype=torch.float64).reshape(1, 3, 2) for name in "qp")
    mass = torch.tensor([law["mass"]], dtype=torch.float64)
    coupling = torch.tensor([asked["coupling"]], dtype=torch.float64)
    params = Parameters(coupling, mass).with_scalar("friction", asked["friction"])
    start, every = PhaseState(q, p), asked["every"]
    found = head.plain_trajectory(start, params, asked["steps"], law["dt"], every)
    return found.states.q[0].flatten(-2).detach().numpy()


@pytest.mark.skipif(NODE is None, reason="no node to run the page's script")
@pytest.mark.parametrize("coupling", [1.0, -1.3])
@pytest.mark.parametrize("friction", [0.0, 0.7])
def test_the_page_rolls_what_python_rolls(played, coupling, friction):
    head, law = played
    heavy = {**law, "mass": [2.5, *law["mass"][1:]]}
    asked = {"coupling": coupling, "friction": friction, "steps": 200, "every": 20}
    learned = by_script(heavy, asked)
    assert learned.shape == (11, 6)
    exact = by_python(head.double().potential, heavy, asked)
    assert np.abs(learned - exact).max() < 1e-5 < np.abs(exact - exact[0]).max()
    truth = by_script(heavy, asked, true=True)
    wanted = by_python(SoftenedGravity(law["softening"]), heavy, asked)
    assert np.abs(truth - wanted).max() < 1e-9


def test_a_model_that_has_no_pair_law_is_not_played():
    assert playing.law_to_play(build(HEADS["unstructured"], bodies=3, dt=0.002)) is None


def test_the_law_is_a_few_kilobytes(played):
    assert len(json.dumps(played[1])) < 80_000
