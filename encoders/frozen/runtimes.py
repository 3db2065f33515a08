"""What computes a frozen network: torch as it is, compiled by torch, or OpenVINO on a CPU.

On a card, what torch compiles is also recorded, so that its kernels are asked for all at once.

The function from pixels to maps is the same; only its execution differs, within the rounding of the
precision that is asked for. OpenVINO is an extra and is imported where it is chosen. It reads the
network in float32 and itself computes in bfloat16 where that is asked for; what it compiles holds
for one shape of pixels, which a pass always has.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Sequence
from typing import Any, Literal

import torch
from torch import Tensor, nn

Runtime = Literal["torch", "compile", "openvino"]
Maps = Callable[[Tensor], Sequence[Tensor]]
PRECISIONS = {"float32": "f32", "bfloat16": "bf16"}


def check_runtime(name: str, runtime: str, dtype: str, device: str) -> None:
    """Refuse a runtime that cannot compute this.

    Args:
        name: of the encoder.
        runtime: see ``Runtime``.
        dtype: of the computation.
        device: where the network is.

    Raises:
        ValueError: an unknown runtime, or OpenVINO without its package, off the CPU, or in a
            precision that it does not have.
    """
    if runtime not in ("torch", "compile", "openvino"):
        raise ValueError(f"{name}: no runtime {runtime!r}; there are torch, compile and openvino")
    if runtime != "openvino":
        return
    if importlib.util.find_spec("openvino") is None:
        raise ValueError(
            f"{name}: runtime openvino is not installed; pip install 'vidphys[openvino]', or use "
            "runtime torch"
        )
    if device != "cpu" or dtype not in PRECISIONS:
        raise ValueError(
            f"{name}: runtime openvino computes on a cpu in float32 or bfloat16, got {device} and "
            f"{dtype}"
        )


def under_runtime(network: nn.Module, maps: Maps, runtime: Runtime, dtype: str) -> Maps:
    """``maps``, computed by the runtime.

    Args:
        network: whose weights ``maps`` uses.
        maps: from pixels to maps of several layers, by torch operations alone.
        runtime: see ``Runtime``.
        dtype: of the computation.
    """
    if runtime == "torch":
        return maps
    if runtime == "compile":
        if not next(network.parameters()).is_cuda:
            return torch.compile(maps, dynamic=False)
        return _kept(torch.compile(maps, dynamic=False, mode="reduce-overhead"))
    return _OpenVINO(_Traceable(network, maps), PRECISIONS[dtype])


def _kept(maps: Maps) -> Maps:
    """Maps of a recorded pass (a CUDA graph), out of the memory that the next one writes to."""

    def whole(pixels: Tensor) -> list[Tensor]:
        torch.compiler.cudagraph_mark_step_begin()
        return [found.clone() for found in maps(pixels)]

    return whole


class _Traceable(nn.Module):
    """The function as a module that owns its weights, which is what can be converted."""

    def __init__(self, network: nn.Module, maps: Maps) -> None:
        super().__init__()
        self.network = network
        self.maps = maps

    def forward(self, pixels: Tensor) -> tuple[Tensor, ...]:
        return tuple(self.maps(pixels))


class _OpenVINO:
    """The compiled network of each shape of pixels, made when it is first met."""

    def __init__(self, module: nn.Module, precision: str) -> None:
        self.module = module
        self.precision = precision
        self.compiled: dict[tuple[int, ...], Any] = {}

    def __call__(self, pixels: Tensor) -> list[Tensor]:
        shape = tuple(pixels.shape)
        if shape not in self.compiled:
            self.compiled[shape] = self._compile(pixels)
        results = self.compiled[shape](pixels.cpu().numpy(), share_inputs=True).values()
        return [torch.from_numpy(result.copy()) for result in results]

    def _compile(self, pixels: Tensor) -> Any:
        import openvino
        from openvino.frontend import FrontEndManager
        from openvino.frontend.pytorch.ts_decoder import TorchScriptPythonDecoder

        # by the front end itself: openvino.convert_model reports usage over the network
        with torch.inference_mode(False), torch.no_grad():
            traced = TorchScriptPythonDecoder(
                self.module, example_input=pixels.clone(), trace_kwargs={"check_trace": False}
            )
        front = FrontEndManager().load_by_framework("pytorch")
        model = front.convert(front.load(traced))
        model.reshape(list(pixels.shape))
        settings = {
            "INFERENCE_PRECISION_HINT": self.precision,
            "INFERENCE_NUM_THREADS": torch.get_num_threads(),
            "PERFORMANCE_HINT": "LATENCY",
        }
        return openvino.Core().compile_model(model, "CPU", settings)
