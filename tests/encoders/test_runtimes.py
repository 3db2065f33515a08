"""Runtimes compute what torch computes, and refuse what they cannot."""

import importlib.util
from types import SimpleNamespace

import pytest
import torch
from torch import nn

from encoders.frozen.base import FrozenEncoder
from encoders.frozen.runtimes import check_runtime, under_runtime
from encoders.frozen.windows import Windowing

needs_openvino = pytest.mark.skipif(
    importlib.util.find_spec("openvino") is None, reason="the extra openvino is not installed"
)


def small_network() -> nn.Module:
    torch.manual_seed(0)
    return nn.Sequential(nn.Conv2d(3, 8, 4, 4), nn.GELU(), nn.Conv2d(8, 5, 1)).eval()


@needs_openvino
@pytest.mark.parametrize(("dtype", "tolerance"), [("float32", 1e-3), ("bfloat16", 2e-2)])
def test_openvino_computes_what_torch_computes(dtype, tolerance):
    network = small_network()
    fast = under_runtime(network, lambda pixels: [network(pixels)], "openvino", dtype)
    for shape in ((2, 3, 16, 16), (1, 3, 8, 16)):
        pixels = torch.randn(shape, generator=torch.Generator().manual_seed(1))
        with torch.inference_mode():
            exact, (found,) = network(pixels), fast(pixels)
        assert found.shape == exact.shape
        assert float((found - exact).norm() / exact.norm()) < tolerance


class SmallEncoder(FrozenEncoder):
    """One feature frame for each frame."""

    def encode(self, clips: torch.Tensor, layers: tuple[str, ...]) -> list[torch.Tensor]:
        (found,) = self.fast_maps(clips.flatten(0, 1).to(self.dtype), layers)
        return [found.unflatten(0, clips.shape[:2])]

    def maps(self, pixels: torch.Tensor, layers: tuple[str, ...]) -> list[torch.Tensor]:
        return [self.network(pixels)]


def encoder_of(runtime: str, dtype: str) -> SmallEncoder:
    settings = SimpleNamespace(dtype=dtype, batch=2, runtime=runtime)
    told = {"name": "small", "code_version": 1, "weights_sha256": "0" * 64}
    told |= {"preprocessing": "none", "layer": "1", "resolution": 16}
    return SmallEncoder(small_network(), settings, Windowing(), **told)


@needs_openvino
def test_an_encoder_has_the_same_features_and_another_identity():
    plain, fast = encoder_of("torch", "float32"), encoder_of("openvino", "bfloat16")
    frames = torch.rand(1, 3, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    times = torch.arange(3).double()
    exact, found = plain(frames, times), fast(frames, times)
    assert float((found.values - exact.values).norm() / exact.values.norm()) < 2e-2
    assert (plain.identity.dtype, fast.identity.dtype) == ("float32", "bfloat16 by openvino")


@pytest.mark.parametrize(
    ("runtime", "dtype", "device", "message"),
    [
        ("onnx", "float32", "cpu", "no runtime 'onnx'; there are torch, compile and openvino"),
        ("openvino", "float16", "cpu", "in float32 or bfloat16, got cpu and float16"),
        ("openvino", "float32", "cuda", "computes on a cpu"),
    ],
)
def test_what_a_runtime_cannot_do_is_refused(runtime, dtype, device, message, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    with pytest.raises(ValueError, match=message):
        check_runtime("dinov2-small", runtime, dtype, device)


def test_a_runtime_that_is_not_installed_says_how_to_get_it(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(
        ValueError, match=r"pip install 'vidphys\[openvino\]', or use runtime torch"
    ):
        check_runtime("dinov2-small", "openvino", "float32", "cpu")
