"""Prediction of hidden features (V-JEPA 2, Assran et al., arXiv:2506.09985).

Most tubelets are left out; the encoder sees the others, and the predictor says what features a
slowly following copy of the encoder, which sees all, gives those that were left out. Encoder and
predictor are those of ``transformers``; the copy is what is released. Unlike the paper, single
tubelets are hidden and not blocks, since a small body would be lost in a block.
"""

from __future__ import annotations

import copy
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from encoders.jepa import ema_momentum, follow
from encoders.preprocess import imagenet_clips
from vidphys.pretraining.clips import Examples, Layout

LAYOUT = Layout(frames=4, side=64, patch=4, tubelet=2, visible=0.2, asked=0.25)
WIDTH, DEPTH, HEADS = 96, 3, 3
PREDICTOR_WIDTH, PREDICTOR_DEPTH, PREDICTOR_HEADS = 64, 2, 2
FIRST_MOMENTUM = 0.99  # share that the teacher keeps in the first step
INITIAL = 0.08  # deviation of initial weights; the libraries' 0.02 is meant for wider layers


class FeaturePrediction(nn.Module):
    """Examples to the mean absolute error of the predicted features."""

    layout = LAYOUT

    def __init__(self) -> None:
        from transformers import VJEPA2Config, VJEPA2Model

        super().__init__()
        config = VJEPA2Config(
            crop_size=LAYOUT.side,
            patch_size=LAYOUT.patch,
            frames_per_clip=LAYOUT.frames,
            tubelet_size=LAYOUT.tubelet,
            hidden_size=WIDTH,
            num_hidden_layers=DEPTH,
            num_attention_heads=HEADS,
            pred_hidden_size=PREDICTOR_WIDTH,
            pred_num_hidden_layers=PREDICTOR_DEPTH,
            pred_num_attention_heads=PREDICTOR_HEADS,
            pred_num_mask_tokens=1,
            initializer_range=INITIAL,
            pred_zero_init_mask_tokens=False,
        )
        self.model: Any = VJEPA2Model(config)
        self.teacher: Any = copy.deepcopy(self.model.encoder).requires_grad_(False)

    def forward(self, batch: Examples) -> Tensor:
        pixels = _pixels(batch)
        with torch.no_grad():
            whole = self.teacher(pixels).last_hidden_state
            # scale and mean of a token are no part of what is asked, as in the paper
            wanted = functional.layer_norm(_taken(whole, batch.asked), whole.shape[-1:])
        context = self._context(pixels, batch.visible)
        # the predictor takes its context out of a full grid of tokens
        grid = torch.zeros_like(whole).scatter(1, _spread(batch.visible, context), context)
        said = self.model.predictor(grid, [batch.visible], [batch.asked]).last_hidden_state
        return functional.l1_loss(said, wanted)

    def after_step(self, step: int, steps: int) -> None:
        """Let the teacher follow."""
        follow(self.teacher, self.model.encoder, ema_momentum(step / steps, FIRST_MOMENTUM))

    def features(self, batch: Examples) -> Tensor:
        """What the adapter will read, ``(b, tokens, k)``."""
        return self.teacher(_pixels(batch)).last_hidden_state

    def release(self) -> tuple[dict[str, Any], dict[str, Tensor]]:
        """Configuration and tensors as the library writes them: the teacher and the predictor."""
        released = copy.deepcopy(self.model)
        released.encoder.load_state_dict(self.teacher.state_dict())
        return self.model.config.to_dict(), released.state_dict()

    def _context(self, pixels: Tensor, visible: Tensor) -> Tensor:
        """The encoder over the visible tokens only, ``(b, v, k)``."""
        encoder = self.model.encoder
        tokens = _taken(encoder.embeddings(pixels), visible)
        for block in encoder.layer:
            tokens = block(tokens, visible)[0]
        return encoder.layernorm(tokens)


def _pixels(batch: Examples) -> Tensor:
    return imagenet_clips(batch.frames, (LAYOUT.side, LAYOUT.side), torch.float32)


def _spread(index: Tensor, like: Tensor) -> Tensor:
    return index.unsqueeze(-1).expand(-1, -1, like.shape[-1])


def _taken(tokens: Tensor, index: Tensor) -> Tensor:
    return tokens.gather(1, _spread(index, tokens))
