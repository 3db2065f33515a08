"""Masked autoencoding of tubelets (VideoMAE, Tong et al., arXiv:2203.12602).

Most tubelets are left out; the encoder sees the others, and a small decoder paints the pixels of
those that were left out. The model and its loss are those of ``transformers``. Two things differ
from the paper: single tubelets are hidden and not whole tubes, since small bodies would be lost
in a tube, and raw pixels are painted, since the normalised ones of an even patch are noise.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from encoders.preprocess import imagenet_clips
from vidphys.pretraining.clips import Examples, Layout

LAYOUT = Layout(frames=4, side=64, patch=4, tubelet=2, visible=0.2, asked=0.8)
WIDTH, DEPTH, HEADS = 96, 3, 3
DECODER_WIDTH, DECODER_DEPTH, DECODER_HEADS = 64, 1, 2
INITIAL = 0.08  # deviation of initial weights; the libraries' 0.02 is meant for wider layers
# The library adds positions of amplitude one to the tokens. Pixels are made to outweigh them, so
# that a token tells what is there alike wherever it is: what is read over it finds that easier.
BRIGHT = 6.0


class MaskedAutoencoding(nn.Module):
    """Examples to the reconstruction loss: mean square error of the hidden pixels."""

    layout = LAYOUT

    def __init__(self) -> None:
        from transformers import VideoMAEConfig, VideoMAEForPreTraining

        super().__init__()
        config = VideoMAEConfig(
            image_size=LAYOUT.side,
            patch_size=LAYOUT.patch,
            num_frames=LAYOUT.frames,
            tubelet_size=LAYOUT.tubelet,
            hidden_size=WIDTH,
            num_hidden_layers=DEPTH,
            num_attention_heads=HEADS,
            intermediate_size=4 * WIDTH,
            use_mean_pooling=False,
            decoder_hidden_size=DECODER_WIDTH,
            decoder_num_hidden_layers=DECODER_DEPTH,
            decoder_num_attention_heads=DECODER_HEADS,
            decoder_intermediate_size=4 * DECODER_WIDTH,
            norm_pix_loss=False,
            initializer_range=INITIAL,
        )
        self.model: Any = VideoMAEForPreTraining(config)
        with torch.no_grad():
            self.model.videomae.embeddings.patch_embeddings.projection.weight.mul_(BRIGHT)

    def forward(self, batch: Examples) -> Tensor:
        hidden = torch.zeros(len(batch.asked), LAYOUT.tokens, dtype=torch.bool)
        hidden = hidden.to(batch.asked.device).scatter(1, batch.asked, True)
        return self.model(_pixels(batch), bool_masked_pos=hidden).loss

    def after_step(self, step: int, steps: int) -> None:
        """Nothing follows the decoder's training."""

    def features(self, batch: Examples) -> Tensor:
        """What the adapter will read, ``(b, tokens, k)``."""
        return self.model.videomae(_pixels(batch)).last_hidden_state

    def release(self) -> tuple[dict[str, Any], dict[str, Tensor]]:
        """Configuration and tensors as the library writes them: encoder and decoder."""
        return self.model.config.to_dict(), self.model.state_dict()


def _pixels(batch: Examples) -> Tensor:
    return imagenet_clips(batch.frames, (LAYOUT.side, LAYOUT.side), torch.float32)
