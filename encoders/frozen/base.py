"""What all frozen encoders share: layers, windows, passes that are filled up, time stamps."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Any, Literal

import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

from encoders.features import FeatureMap, FeatureStream
from encoders.frozen.runtimes import Maps, Runtime, check_runtime, under_runtime
from encoders.frozen.tokens import chosen_layer
from encoders.frozen.transfers import sent
from encoders.frozen.windows import Window, Windowing, feature_times, seen_by, windows
from encoders.grid import Size, stride_of
from encoders.identity import EncoderIdentity
from encoders.preprocess import Fitting

Dtype = Literal["float32", "bfloat16", "float16"]
DTYPES = {"float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}
RANGE_TOLERANCE = 1e-3

Job = tuple[Tensor, Window]  # the frames (f, c, H, W) that a window sees


class FrozenEncoder(ABC):
    """Frames to feature maps, window by window; subclasses say what happens to one pass.

    A pass always has ``batch`` windows; the last one is filled up with copies, so that a clip has
    the same features whatever it is encoded together with. One pass gives any of :attr:`layers`; an
    encoder by itself gives that of its identity, and :meth:`at` is the same network at another.

    Args:
        network: frozen, cast and put into evaluation mode here; where it runs, features are left.
        settings: the encoder's own, of which ``dtype``, ``batch`` (windows per pass) and, where it
            has them, ``frame_stride`` (take each so-many-th frame, before windows are made) and
            ``runtime`` are read here.
        windowing: how the network samples time.
        layers: names of all that can be read, in order of depth; the identity's alone where not
            given.
        identity: what the features depend on, but for ``dtype``, which stands in the settings.

    Raises:
        ValueError: a stride or a batch below one, or a runtime that cannot be used here.
    """

    fitting: Fitting | None = None  # how frames become the network's input, where they may be cut

    def __init__(
        self,
        network: nn.Module,
        settings: Any,
        windowing: Windowing,
        layers: tuple[str, ...] = (),
        **identity: Any,
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
        self._fast: dict[tuple[str, ...], Maps] = {}
        self.runtime: Runtime = runtime
        self.settings, self.windowing = settings, windowing
        self.layers = layers or (identity["layer"],)
        self.frame_stride, self.batch = frame_stride, batch
        self.identity = EncoderIdentity(**identity, dtype=computed_in(dtype, runtime))

    @property
    def frames_per_feature(self) -> int:
        """Frames of the clip from a feature frame to the next one."""
        return self.frame_stride * self.windowing.tubelet

    @property
    def sight(self) -> Hashable:
        """What the pixels of a pass depend on; layers where it is the same share a pass."""
        return self.windowing

    def framed(self, size: Size) -> Size:
        """The size (height, width) of frames, with the border of them that features leave out."""
        return size if self.fitting is None else self.fitting.framed(size)

    def at(self, layer: int | str) -> FrozenEncoder:
        """The same network at another layer; nothing is loaded or copied.

        Raises:
            ValueError: no such layer; those that there are are named.
        """
        chosen = chosen_layer(self.identity.name, layer, self.layers)
        other = copy.copy(self)
        other.identity = replace(self.identity, layer=chosen)
        return other

    def maps(self, pixels: Tensor, layers: tuple[str, ...]) -> Sequence[Tensor]:
        """The network alone, from its own pixels, as a runtime can take it over."""
        raise NotImplementedError(f"{self.identity.name}: has no runtime but torch")

    def fast_maps(self, pixels: Tensor, layers: tuple[str, ...]) -> Sequence[Tensor]:
        """As :meth:`maps`, by the runtime that was asked for."""
        if layers not in self._fast:
            maps = partial(self.maps, layers=layers)
            self._fast[layers] = under_runtime(
                self.network, maps, self.runtime, self.settings.dtype
            )
        return self._fast[layers](pixels)

    @abstractmethod
    def encode(
        self, clips: Float[Tensor, "n f c H W"], layers: tuple[str, ...]
    ) -> Sequence[Float[Tensor, "n t k h w"]]:
        """The maps of ``n`` windows of frames with values in [0, 1], of one layer after the other.

        The layers are some of :attr:`layers`, in their order, and of one :attr:`sight`.
        """

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
        layer = self.identity.layer
        return self.encode_layers(frames, times, (layer,), progress)[layer]

    def encode_layers(
        self,
        frames: Float[Tensor, "b t c H W"] | UInt8[Tensor, "b t c H W"],
        times: Float[Tensor, " t"],
        layers: Sequence[int | str],
        progress: Callable[[int, int], None] | None = None,
    ) -> dict[str, FeatureMap]:
        """Several layers of the same clips, from one pass for all that see the same pixels.

        Args:
            frames, times, progress: see :meth:`__call__`.
            layers: some of :attr:`layers`.

        Returns:
            By the layer's name what :meth:`at` that layer gives.

        Raises:
            ValueError: see :meth:`__call__` and :meth:`at`.

        Example:
            >>> from encoders import load_encoder
            >>> encoder = load_encoder("dino-tiny", {})
            >>> clip, times = torch.zeros(1, 2, 3, 64, 64), torch.tensor([0.0, 0.1])
            >>> maps = encoder.encode_layers(clip, times, encoder.layers)
            >>> list(maps), tuple(maps["2"].values.shape)
            (['1', '2', '3'], (1, 2, 96, 16, 16))
        """
        check_frames(self.identity.name, frames, times)
        groups = self.groups(layers)
        found: dict[str, FeatureMap] = {}
        for done, (seer, group) in enumerate(groups):
            told = _part_of(progress, done, len(groups))
            found |= seer._together(frames, times, group, told)
        return {layer: found[layer] for layer in (self.at(x).identity.layer for x in layers)}

    def _together(
        self,
        frames: Tensor,
        times: Tensor,
        layers: tuple[str, ...],
        progress: Callable[[int, int], None] | None,
    ) -> dict[str, FeatureMap]:
        """Layers that see the same windows of the same pixels."""
        count, size = (
            frames.shape[0] * frames.shape[1],
            self.framed((frames.shape[-2], frames.shape[-1])),
        )
        frames, times = frames[:, :: self.frame_stride], times[:: self.frame_stride]
        plan = windows(frames.shape[1], self.windowing)
        jobs = ((clip[list(window.frames)], window) for clip in frames for window in plan)
        told = _counted(progress, len(frames) * len(plan), count)
        passes = zip(*self._passes(jobs, layers, told), strict=True)
        stamps = feature_times(times, self.windowing)
        features = {}
        for layer, maps in zip(layers, passes, strict=True):
            values = torch.cat(maps).unflatten(0, (len(frames), -1))
            features[layer] = FeatureMap(values, stride_of(size, values.shape), stamps)
        return features

    def stream(
        self,
        chunks: Callable[[], Iterable[Tensor]],
        size: tuple[int, int],
        times: Float[Tensor, " t"],
        layers: Sequence[int | str],
        progress: Callable[[int, int], None] | None = None,
    ) -> Iterator[FeatureStream]:
        """Encode one clip as its frames come in; a few windows of them are held at a time.

        Args:
            chunks: gives its frames, bytes ``(n, c, H, W)``, in order; called once for all layers
                that see the same pixels.
            size: of the frames, (height, width).
            times: seconds of each frame.
            layers: some of :attr:`layers`.
            progress: called as ``(frames done, frames)``.

        Returns:
            One stream after the other, each to be used up before the next, which between them have
            of each layer what :meth:`at` that layer gives.

        Raises:
            ValueError: no frames, no such layer, or fewer frames than times.
        """
        check_count(self.identity.name, len(times))
        taken = times[:: self.frame_stride]
        groups = self.groups(layers)
        for done, (seer, group) in enumerate(groups):
            told = _part_of(progress, done, len(groups))
            plan = windows(len(taken), seer.windowing)
            jobs = zip(seen_by(plan, chunks(), self.frame_stride), plan, strict=True)
            pieces = seer._passes(jobs, group, _counted(told, len(plan), len(times)))
            stamps = feature_times(taken, seer.windowing)
            yield FeatureStream(group, pieces, self.framed(size), stamps)

    def groups(self, layers: Sequence[int | str]) -> list[tuple[FrozenEncoder, tuple[str, ...]]]:
        """Layers that see the same windows of the same pixels, and an encoder of them."""
        asked = {encoder.identity.layer: encoder for encoder in map(self.at, layers)}
        together: dict[Hashable, list[str]] = {}
        for layer in sorted(asked, key=self.layers.index):
            together.setdefault(asked[layer].sight, []).append(layer)
        return [(asked[group[0]], tuple(group)) for group in together.values()]

    @property
    def device(self) -> torch.device:
        """Where the network is."""
        return next(self.network.parameters()).device

    def _passes(
        self, jobs: Iterable[Job], layers: tuple[str, ...], told: Callable[[int], None]
    ) -> Iterator[list[Tensor]]:
        """Of each layer features ``(f, c, h, w)`` of some windows, pass by pass."""
        waiting, done = iter(jobs), 0
        while some := [*islice(waiting, self.batch)]:
            with torch.inference_mode():
                found = self.one_pass(some, layers)
            done += len(some)
            told(done)
            # outside of inference mode: readouts may be trained on them
            yield [torch.cat(maps) for maps in found]

    def one_pass(self, jobs: list[Job], layers: tuple[str, ...]) -> list[list[Tensor]]:
        """Of each layer, the kept maps of each window."""
        filled = jobs + jobs[-1:] * (self.batch - len(jobs))
        clips = sent(torch.stack([seen for seen, _ in filled]), self.device)
        light = clips.float() if clips.is_floating_point() else clips.float() / 255
        return [
            [maps[i, window.span].float() for i, (_, window) in enumerate(jobs)]
            for maps in self.encode(light, layers)
        ]


def _counted(
    progress: Callable[[int, int], None] | None, windows: int, frames: int
) -> Callable[[int], None]:
    """Progress in windows, told in frames."""
    if progress is None:
        return lambda done: None
    return lambda done: progress(frames * done // windows, frames)


def _part_of(
    progress: Callable[[int, int], None] | None, number: int, parts: int
) -> Callable[[int, int], None] | None:
    """The progress of one of several equal parts."""
    if progress is None:
        return None
    return lambda done, count: progress((number * count + done) // parts, count)


def computed_in(dtype: str, runtime: Runtime) -> str:
    """How features were computed, for their identity; torch's own goes without saying."""
    return dtype if runtime == "torch" else f"{dtype} by {runtime}"


def check_count(name: str, frames: int) -> None:
    """Refuse a clip without frames."""
    if not frames:
        raise ValueError(f"{name}: needs at least one frame")


def check_frames(name: str, frames: Tensor, times: Tensor) -> None:
    """Refuse frames that are none, see :meth:`FrozenEncoder.__call__`."""
    check_count(name, frames.shape[0] * frames.shape[1])
    if frames.shape[2] not in (1, 3) and frames.shape[-1] in (1, 3):
        raise ValueError(
            f"{name}: frames {tuple(frames.shape)} have their channels last; give (b, t, c, H, W), "
            "or call vidphys.encode_video, which takes any order"
        )
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
