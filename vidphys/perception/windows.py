"""Training examples cut from clips: single frames, and short windows of neighbouring frames."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from dynamics import Parameters
from vidphys.data.clips import Clips
from vidphys.errors import InputError
from vidphys.shooting.step import HEAD_DT


@dataclass(frozen=True)
class FrameBatches:
    """All frames of some clips, each with where its bodies are.

    Args:
        frames: bytes, ``(f, c, H, W)``.
        targets: ``(f, n, 2)``.
    """

    frames: Tensor
    targets: Tensor

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: Tensor) -> tuple[Tensor, Tensor]:
        """Frames in [0, 1] as clips of one frame, ``(m, 1, c, H, W)``, and ``(m, n, 2)``."""
        return self.frames[index].unsqueeze(1).float() / 255, self.targets[index]


@dataclass(frozen=True)
class Window:
    """A batch of windows: frames in [0, 1], their law, and targets if there are any.

    Args:
        frames: ``(m, length, c, H, W)``.
        params: ``(m,)`` and ``(m, n)``, float32.
        targets: ``(m, length, n, 2)``, or ``None``.
    """

    frames: Tensor
    params: Parameters
    targets: Tensor | None


@dataclass(frozen=True)
class WindowBatches:
    """Every window of ``length`` frames in some clips.

    Args:
        clips: where they are cut from; their states are not read.
        length: frames of a window.
        targets: positions that belong to the frames, ``(b, t, n, 2)``, or ``None``.

    Raises:
        InputError: the clips are shorter than a window.
    """

    clips: Clips
    length: int
    targets: Tensor | None = None

    def __post_init__(self) -> None:
        if self.starts < 1:
            raise InputError(
                f"clips of {self.clips.frames.shape[1]} frames: this perception learns from "
                f"windows of {self.length}; use longer clips"
            )

    @property
    def starts(self) -> int:
        """Windows in a clip."""
        return self.clips.frames.shape[1] - self.length + 1

    def __len__(self) -> int:
        return len(self.clips) * self.starts

    def __getitem__(self, index: Tensor) -> Window:
        clip = index // self.starts
        frame = (index % self.starts)[:, None] + torch.arange(self.length)
        return Window(
            self.clips.frames[clip[:, None], frame].float() / 255,
            self.clips.params[clip].map(lambda x: x.float()),
            None if self.targets is None else self.targets[clip[:, None], frame],
        )


def steps_per_frame(clips: Clips) -> int:
    """Model steps of ``HEAD_DT`` seconds between two frames.

    Raises:
        InputError: the frame interval is not a whole number of them.
    """
    steps = round(clips.interval / HEAD_DT)
    if steps < 1 or abs(steps * HEAD_DT - clips.interval) > 1e-6:
        raise InputError(
            f"frame interval {clips.interval:g} s: must be a multiple of the head's step "
            f"{HEAD_DT} s; choose another stride"
        )
    return steps
