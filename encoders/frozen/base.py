"""What all frozen encoders share: checks, windows, passes that are filled up, time stamps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Literal

import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

from encoders.features import FeatureMap
from encoders.frozen.runtimes import Runtime, check_runtime, under_runtime
from encoders.frozen.windows import Window, Windowing, feature_times, windows
from encoders.identity import EncoderIdentity

Dtype = Literal["float32", "bfloat16", "float16"]
DTYPES = {"float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}
RANGE_TOLERANCE = 1e-3


class FrozenEncoder(ABC):
    """Frames to feature maps, window by window; subclasses say what happens to one pass.

    A pass always has ``batch`` windows; the last one is filled up with copies, so that a clip has
    the same features whatever it is encoded together with.

    Args:
        network: frozen, cast and put into evaluation mode here; where it runs, features are left.
        settings: the encoder's own, of which ``dtype``, ``batch`` (windows per pass) and, where it
            has them, ``frame_stride`` (take each so-many-th frame, before windows are made) and
            ``runtime`` are read here.
        windowing: how the network samples time.
        identity: what the features depend on, but for ``dtype``, which stands in the settings.

    Raises:
        ValueError: a stride or a batch below one, or a runtime that cannot be used here.
    """

    def __init__(
        self, network: nn.Module, settings: Any, windowing: Windowing, **identity: Any
    ) -> None:
        name, dtype, batch = identity["name"], settings.dtype, settings.batch
        frame_stride: int = getattr(settings, "frame_stride", 1)
        runtime: Runtime = getattr(settings, "runtime", "torch")
        for count, value in (("frame_stride", frame_stride), ("batch", batch)):
            if value < 1:
                raise ValueError(f"{name}: {count} {value}: must be at least 1")
        device = next((p.device.type for p in network.parameters()), "cpu")
        check_runtime(name, runtime, dtype, device)
        # OpenVINO casts by itself, from float32
        self.dtype = DTYPES["float32" if runtime == "openvino" else dtype]
        self.network = network.to(self.dtype).eval().requires_grad_(False)
        self.fast_maps = under_runtime(self.network, self.maps, runtime, dtype)
        self.settings, self.windowing = settings, windowing
        self.frame_stride, self.batch = frame_stride, batch
        self.identity = EncoderIdentity(**identity, dtype=computed_in(dtype, runtime))

    @property
    def frames_per_feature(self) -> int:
        """Frames of the clip from a feature frame to the next one."""
        return self.frame_stride * self.windowing.tubelet

    def maps(self, pixels: Tensor) -> Tensor:
        """The network alone, from its own pixels, as a runtime can take it over."""
        raise NotImplementedError(f"{self.identity.name}: has no runtime but torch")

    @abstractmethod
    def encode(self, clips: Float[Tensor, "n f c H W"]) -> Float[Tensor, "n t k h w"]:
        """The network's maps of ``n`` windows of frames with values in [0, 1]."""

    def __call__(
        self,
        frames: Float[Tensor, "b t c H W"] | UInt8[Tensor, "b t c H W"],
        times: Float[Tensor, " t"],
        progress: Callable[[int, int], None] | None = None,
    ) -> FeatureMap:
        """Encode clips.

        Args:
            frames: values in [0, 1], or bytes; bytes become floats a pass at a time.
            times: seconds of each frame.
            progress: called as ``(frames done, frames)``, counted over all clips.

        Returns:
            A map whose stride is in pixels of ``frames``, so that its cell centres are those of
            the given image even where the resizing changed the aspect ratio.

        Raises:
            ValueError: no frames, times that are not theirs, or values out of range.
        """
        check_frames(self.identity.name, frames, times)
        height, width = frames.shape[-2:]
        count = frames.shape[0] * frames.shape[1]
        frames, times = frames[:, :: self.frame_stride], times[:: self.frame_stride]
        plan = windows(frames.shape[1], self.windowing)
        jobs = [(clip, window) for clip in range(len(frames)) for window in plan]
        kept: list[Tensor] = []
        with torch.inference_mode():
            for start in range(0, len(jobs), self.batch):
                kept += self._pass(frames, jobs[start : start + self.batch])
                if progress is not None:
                    progress(count * min(start + self.batch, len(jobs)) // len(jobs), count)
            values = torch.cat(kept).unflatten(0, (len(frames), -1))
        h, w = values.shape[-2:]
        # leaving inference mode by a copy lets readouts be trained on the features
        stamps = feature_times(times, self.windowing)
        return FeatureMap(values.clone(), (height / h, width / w), stamps)

    def _pass(self, frames: Tensor, jobs: list[tuple[int, Window]]) -> list[Tensor]:
        filled = jobs + jobs[-1:] * (self.batch - len(jobs))
        clips = torch.stack([frames[clip, list(window.frames)] for clip, window in filled])
        clips = clips.to(next(self.network.parameters()).device)
        maps = self.encode(clips.float() if clips.is_floating_point() else clips.float() / 255)
        return [maps[i, list(window.kept)].float() for i, (_, window) in enumerate(jobs)]


def computed_in(dtype: str, runtime: Runtime) -> str:
    """How features were computed, for their identity; torch's own goes without saying."""
    return dtype if runtime == "torch" else f"{dtype} by {runtime}"


def check_frames(name: str, frames: Tensor, times: Tensor) -> None:
    """Refuse frames that are none, see :meth:`FrozenEncoder.__call__`."""
    if frames.shape[0] * frames.shape[1] == 0:
        raise ValueError(f"{name}: needs at least one frame, got shape {tuple(frames.shape)}")
    if len(times) != frames.shape[1]:
        raise ValueError(
            f"{name}: {frames.shape[1]} frames have {len(times)} times; give the seconds of each"
        )
    if not frames.is_floating_point():
        return
    low, high = (float(value) for value in frames.aminmax())
    if not high - low < float("inf"):
        raise ValueError(f"{name}: frames must be finite; a pixel is NaN or infinite")
    if low < -RANGE_TOLERANCE or high > 1 + RANGE_TOLERANCE:
        raise ValueError(
            f"{name}: frames must have values in [0, 1], got {low:.3g} to {high:.3g}; divide bytes "
            "by 255 or give them as uint8"
        )
