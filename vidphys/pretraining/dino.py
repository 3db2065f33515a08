"""Self-distillation of image patches (DINOv2's patch loss, Oquab et al., arXiv:2304.07193).

A slowly following teacher sorts every patch of a frame into prototypes; the student, in whose
frame the colours are others and half of the patches are grey, says the teacher's sorting of all.
The colours are what keeps it from sorting patches by colour, in place of by what is there. The
teacher's scores are centred and sharpened, which is what keeps all patches from falling into one
prototype. The transformer is that of ``timm``; the teacher's is what is released. DINOv2's other
loss, of the class token over crops, is left out: it asks for what crops have in common, and where
a body is they do not.
"""

from __future__ import annotations

import copy
from typing import Any

import torch
from torch import Tensor, nn

from encoders.jepa import ema_momentum, follow
from encoders.preprocess import IMAGENET_MEAN, IMAGENET_STD, imagenet_clips
from vidphys.pretraining.clips import Examples, Layout

# what is asked is grey; the loss is of all patches
LAYOUT = Layout(frames=1, side=64, patch=4, tubelet=1, visible=0.5, asked=0.5)
ARCHITECTURE = "vit_small_patch14_dinov2"
WIDTH = 96
ARGUMENTS: dict[str, Any] = {
    "img_size": LAYOUT.side,
    "patch_size": LAYOUT.patch,
    "embed_dim": WIDTH,
    "depth": 3,
    "num_heads": 3,
    "init_values": 1.0,  # the library's initial weights are meant for wider and deeper networks
    "weight_init": "jax",
}
PROTOTYPES, HEAD_WIDTH = 256, 64
STUDENT_TEMPERATURE, TEACHER_TEMPERATURE = 0.1, 0.05
CENTRE_MOMENTUM = 0.9
FIRST_MOMENTUM = 0.99  # share that the teacher keeps in the first step


class PatchDistillation(nn.Module):
    """Examples to the cross-entropy of the student's sorting of patches."""

    layout = LAYOUT

    def __init__(self) -> None:
        import timm

        super().__init__()
        student = timm.create_model(
            ARCHITECTURE, pretrained=False, num_classes=0, dynamic_img_size=True, **ARGUMENTS
        )
        head = _Head(WIDTH)
        self.student: Any = student
        self.head: Any = head
        self.teacher: Any = copy.deepcopy(student).requires_grad_(False)
        self.teacher_head: Any = copy.deepcopy(head).requires_grad_(False)
        self.register_buffer("centre", torch.zeros(PROTOTYPES))
        self.centre: Tensor

    def forward(self, batch: Examples) -> Tensor:
        with torch.no_grad():
            scores = self.teacher_head(_tokens(self.teacher, _pixels(batch)))
            wanted = ((scores - self.centre) / TEACHER_TEMPERATURE).softmax(-1)
            if self.training:
                self.centre.lerp_(scores.mean((0, 1)), 1 - CENTRE_MOMENTUM)
        shown = _hide(_pixels(batch.recoloured()), batch.asked)
        said = self.head(_tokens(self.student, shown)) / STUDENT_TEMPERATURE
        return -(wanted * said.log_softmax(-1)).sum(-1).mean()

    def after_step(self, step: int, steps: int) -> None:
        """Let the teacher follow."""
        kept = ema_momentum(step / steps, FIRST_MOMENTUM)
        follow(self.teacher, self.student, kept)
        follow(self.teacher_head, self.head, kept)

    def features(self, batch: Examples) -> Tensor:
        """What the adapter will read, ``(b, tokens, k)``."""
        return _tokens(self.teacher, _pixels(batch))

    def release(self) -> tuple[dict[str, Any], dict[str, Tensor]]:
        """Configuration and tensors as the library writes them: the teacher."""
        seen = {
            "input_size": (3, LAYOUT.side, LAYOUT.side),
            "mean": IMAGENET_MEAN,
            "std": IMAGENET_STD,
        }
        config = {
            "architecture": ARCHITECTURE,
            "num_classes": 0,
            "num_features": WIDTH,
            "model_args": ARGUMENTS,
            "pretrained_cfg": seen,
        }
        return config, self.teacher.state_dict()


class _Head(nn.Module):
    """Tokens to cosines with the prototypes."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.inner = nn.Sequential(
            nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, HEAD_WIDTH)
        )
        self.prototypes = nn.Parameter(torch.randn(PROTOTYPES, HEAD_WIDTH))

    def forward(self, tokens: Tensor) -> Tensor:
        inner = nn.functional.normalize(self.inner(tokens), dim=-1)
        return inner @ nn.functional.normalize(self.prototypes, dim=-1).T


def _pixels(batch: Examples) -> Tensor:
    return imagenet_clips(batch.frames, (LAYOUT.side, LAYOUT.side), torch.float32)[:, 0]


def _tokens(network: Any, pixels: Tensor) -> Tensor:
    """Patch tokens after the last norm."""
    return network.forward_features(pixels)[:, network.num_prefix_tokens :]


def _hide(pixels: Tensor, hidden: Tensor) -> Tensor:
    """The pixels of hidden patches become grey (zero after normalisation)."""
    side = LAYOUT.side // LAYOUT.patch
    shown = pixels.new_ones(len(pixels), side**2).scatter(1, hidden, 0.0)
    shown = shown.view(-1, 1, side, side)
    return pixels * nn.functional.interpolate(shown, scale_factor=float(LAYOUT.patch))
