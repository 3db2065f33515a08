"""On a card: the numbers of the CPU, the state never below single precision, no silent CPU."""

import copy
from dataclasses import replace

import pytest
import torch

from dynamics import HEADS, Parameters, PhaseState, build, engines, rollout, terms
from dynamics.compiled import compile_head
from dynamics.mlp import MLP
from dynamics.potentials import DisplacementPotential
from encoders import load_encoder
from renderers import Camera, disks, gaussians, reused
from tests.shared.graphs import goes_through
from tests.shared.recorded_steps import asking_and_plain, head_to_roll, recorded_and_plain
from tests.shared.small_studies import TINY
from vidphys.devices import prepare_device
from vidphys.experiments.catalogue import TABLES
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.ladder import ALL_HEADS
from vidphys.placement import device_of, moved, suited
from vidphys.scenes import gravity

pytestmark = [pytest.mark.gpu, pytest.mark.timeout(600)]
RUNGS = (
    "renderer",
    "cnn-supervised",
    "cnn-discovered",
    "jepa-centroid",
    "rgb-tracked",
    "anonymous-hand",
    "anonymous-tracker",
    "anonymous-slots",
    "dino-tiny",
    "videomae-tiny",
    "vjepa2-tiny",
    "composed",
)


def rows(cell, device, folder):
    prepare_device(device)
    pixel = replace(TINY.pixel, frames=8)  # which every encoder's feature frames divide
    task = CellTask("ladder", cell, (0,), TINY.oracle, pixel, device, folder)
    TABLES["ladder"].cells[cell](task)
    return [row for each in task.recorders for row in each.tables()[0].to_pylist()]


@pytest.mark.parametrize(
    "cell", [f"oracle/{h}" for h in ALL_HEADS] + [f"{r}/factored" for r in RUNGS]
)
def test_a_cell_of_the_ladder(cell, tmp_path):
    """What a few steps of training and 150 of a rollout leave of the difference in rounding."""
    here, there = (rows(cell, device, tmp_path / device) for device in ("cpu", "cuda"))
    assert [r["metric"] for r in here] == [r["metric"] for r in there]
    assert all(torch.cuda.get_device_name() in row["device"] for row in there)
    for ours, theirs in zip(here, there, strict=True):
        if ours["metric"] in ("position_nmse", "training_loss", "held_out_one_step_error"):
            assert theirs["value"] == pytest.approx(ours["value"], rel=0.02, abs=1e-6)


@pytest.mark.parametrize("name", HEADS.ours())
def test_a_head_rolls_where_it_is(name, monkeypatch):
    monkeypatch.setattr(engines, "FEWEST_STEPS", 16)
    head, start, law, dt = head_to_roll(name)
    found = {}
    for device in ("cpu", "cuda"):
        model = head.to(device)
        rolled = rollout(model, *suited((start, law), model), 20, dt)
        assert device == "cpu" or rolled.backend in ("triton", "cuda graph")
        assert rolled.states.q.device.type == device_of(model).type == device
        assert rolled.states.q.dtype == torch.float32
        found[device] = rolled.states.flat.cpu()
    assert (found["cpu"] - found["cuda"]).abs().max() < 1e-4


def test_the_fused_kernel_is_the_spline_of_the_cpu():
    scene = gravity()
    start, law = moved(scene.sample(64, torch.Generator().manual_seed(0)), "cpu", torch.float32)
    torch.manual_seed(0)
    head = scene.build(HEADS["factored-radial"]).eval()
    head.see(start)
    fast = compile_head(head, tolerance=1e-3)
    with torch.no_grad():
        here = fast.trajectory(start, law, 50, scene.dt).states.flat
        there = fast.to("cuda").trajectory(*moved((start, law), "cuda"), 50, scene.dt)
    assert there.backend == "triton"
    assert (there.states.flat.cpu() - here).abs().max() < 1e-4


@pytest.mark.parametrize(("bodies", "width"), [(3, 256), (2, 64), (8, 48)])
def test_the_kernel_of_a_network_is_the_network(bodies, width):
    """To what single precision leaves of it, in double precision on the CPU."""
    scene = gravity()
    torch.manual_seed(0)
    head = build(terms.Hamiltonian(potentials=(terms.Displacement(width=width),)), bodies, scene.dt)
    q, p = torch.randn(2, 100, bodies, 2).double()
    start, law = PhaseState(q, p), Parameters(torch.ones(100).double(), torch.ones(100, bodies))
    law = moved(law, "cpu", torch.float64)
    with torch.no_grad():
        there = head.to("cuda").trajectory(*moved((start, law), "cuda", torch.float32), 100, 0.01)
        here = head.to("cpu").double().plain_trajectory(start, law, 100, 0.01)
    assert there.backend == "triton"
    assert (there.states.flat.cpu() - here.states.flat).abs().max() < 2e-5


def close_to_double(model, gradient, through, count, tolerance):
    """Hold a gradient at points of two coordinates, and its way back, to double precision's.

    Args:
        model: its last parameter, a bias, shifts no gradient.
        gradient: of the model on a device, at points there.
        through: the function by which it is on the card.
        count: of points.
        tolerance: of the largest number.
    """
    x, upstream = torch.randn(2, count, 2)
    found = {}
    for device, dtype in (("cpu", torch.float64), ("cuda", torch.float32)):
        there, at = copy.deepcopy(model).to(device, dtype), moved(x, device, dtype)
        at.requires_grad_()
        out = gradient(there, at)
        assert device == "cpu" or goes_through(out, through)
        weights = list(there.parameters())[:-1]
        back = torch.autograd.grad(out, [at, *weights], moved(upstream, device, dtype))
        found[device] = [out.detach(), *back]
    for one, other in zip(found["cpu"], found["cuda"], strict=True):
        assert (other.cpu() - one).abs().max() < tolerance * one.abs().max()


@pytest.mark.parametrize(("rows", "width"), [(6144, 256), (150, 48), (64, 512)])
def test_the_input_gradient_of_a_network_is_the_network_s(rows, width):
    """It and its way back, to what single precision leaves of double."""
    torch.manual_seed(0)
    network = MLP((2, width, width, 1))
    close_to_double(network, MLP.gradient, "_Gradient", rows, 3e-6)


@pytest.mark.parametrize(("pairs", "width"), [(3072, 256), (1, 64)])
def test_the_gradient_of_a_pair_law_is_the_law_s(pairs, width):
    """As of a network; slopes at both of its inputs nearly cancel, also in torch's own."""
    torch.manual_seed(0)
    law = DisplacementPotential(2, width, "tanh")
    close_to_double(law, DisplacementPotential.pair_gradient, "_Turned", pairs, 1e-5)


def test_a_recorded_training_step_is_the_same_step():
    recorded_and_plain()


def test_a_loss_that_asks_the_card_for_numbers_is_computed_as_it_is():
    asking_and_plain()


def test_a_recorded_encoder_is_the_encoder():
    """Each pass's features are its own, not those of the pass that wrote there next."""
    plain = load_encoder("dino-tiny", {"batch": 4}, None, "cuda")
    fast = load_encoder("dino-tiny", {"batch": 4, "runtime": "compile"}, None, "cuda")
    frames = torch.rand(1, 12, 3, 64, 64)
    times = torch.arange(12, dtype=torch.float64)
    there, here = fast(frames, times).values, plain(frames, times).values
    assert (there - here).norm() < 1e-3 * here.norm()


@pytest.mark.parametrize("name", ["gaussians", "disks"])
def test_splats_drawn_into_memory_are_those_of_the_cpu(name):
    camera = Camera(height=224, width=224)
    q, upstream = torch.randn(16, 3, 2), torch.randn(16, 3, 224, 224)
    pictures, slopes = [], []
    for device in ("cpu", "cuda", "cuda"):
        x, out = q.to(device).requires_grad_(), torch.full_like(upstream, torch.nan, device=device)
        if name == "disks":
            drawn = disks(x, camera, 0.6, 0.1, out)
        else:
            drawn = gaussians(x, camera, 0.5, out)
        pictures.append(drawn.detach().cpu())
        slopes.append(torch.autograd.grad(drawn, x, upstream.to(device))[0].cpu())
    assert reused._loops(drawn).__name__ == "renderers.compiled_cuda"
    assert (pictures[1] - pictures[0]).abs().max() < 1e-5
    assert (slopes[1] - slopes[0]).abs().max() < 1e-5 * slopes[0].abs().max()
    assert torch.equal(pictures[1], pictures[2])
    assert torch.equal(slopes[1], slopes[2])


def test_a_training_step_keeps_its_batches_on_the_card(tmp_path):
    sizes = replace(TINY.oracle, steps=5)
    task = CellTask("ladder", "oracle/factored", (0,), sizes, device="cuda", folder=tmp_path)
    torch.cuda.reset_peak_memory_stats()
    TABLES["ladder"].cells["oracle/factored"](task)
    assert torch.cuda.max_memory_allocated() > 0
