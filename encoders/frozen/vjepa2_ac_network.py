"""The predictor of V-JEPA 2-AC (Assran et al., arXiv:2506.09985): the next frame's tokens.

Each frame is an action token, a state token and its patches; a token sees its own frame and those
before. Places are rotary in time, row and column, and the two extra tokens turn with time alone.
Parameters have the names of the official release, so that it loads strictly.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional

HEAD = 64  # channels of an attention head, in the encoder and in the predictor
ACTION = 7  # numbers of an action, and of a state: place, angles, gripper
EXTRA = 2  # tokens of a frame beside its patches
EPSILON = 1e-6


class Predictor(nn.Module):
    """Tokens of frames to those of the frames after them.

    Args:
        channels: of the encoder's tokens.
        width: of the predictor's; a multiple of ``HEAD``.
        hidden: of its feed-forward layers.
        depth: blocks.
    """

    def __init__(self, channels: int, width: int, hidden: int, depth: int) -> None:
        super().__init__()
        self.predictor_embed = nn.Linear(channels, width)
        self.action_encoder = nn.Linear(ACTION, width)
        self.state_encoder = nn.Linear(ACTION, width)
        self.extrinsics_encoder = nn.Linear(ACTION - 1, width)  # of the camera; never told
        self.predictor_blocks = nn.ModuleList(_Block(width, hidden) for _ in range(depth))
        self.predictor_norm = nn.LayerNorm(width, eps=EPSILON)
        self.predictor_proj = nn.Linear(width, channels)

    def forward(
        self,
        tokens: Float[Tensor, "n t m k"],
        grid: tuple[int, int],
        action: Float[Tensor, " a"],
        state: Float[Tensor, " a"],
    ) -> Float[Tensor, "n t m k"]:
        """What each frame's tokens will be in the next frame, given the frames up to it.

        Args:
            tokens: of each frame's patches, row by row, normalised.
            grid: rows and columns of patches.
            action, state: of the arm, the same in every frame.
        """
        n, t = tokens.shape[:2]
        told = torch.stack([self.action_encoder(action), self.state_encoder(state)])
        x = torch.cat([told.expand(n, t, -1, -1), self.predictor_embed(tokens)], 2).flatten(1, 2)
        places = _places(t, grid).to(x)
        seen = _up_to_now(t, len(places) // t).to(x.device)
        for block in self.predictor_blocks:
            x = block(x, places, seen)
        patches = x.unflatten(1, (t, -1))[:, :, EXTRA:]
        return self.predictor_proj(self.predictor_norm(patches))


class _Block(nn.Module):
    def __init__(self, width: int, hidden: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(width, eps=EPSILON)
        self.attn = _Attention(width)
        self.norm2 = nn.LayerNorm(width, eps=EPSILON)
        self.mlp = _FeedForward(width, hidden)

    def forward(self, x: Tensor, places: Tensor, seen: Tensor) -> Tensor:
        x = x + self.attn(self.norm1(x), places, seen)
        return x + self.mlp(self.norm2(x))


class _FeedForward(nn.Module):
    def __init__(self, width: int, hidden: int) -> None:
        super().__init__()
        self.fc1, self.fc2 = nn.Linear(width, hidden), nn.Linear(hidden, width)

    def forward(self, x: Tensor) -> Tensor:
        return self.fc2(functional.gelu(self.fc1(x)))


class _Attention(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.qkv, self.proj = nn.Linear(width, 3 * width), nn.Linear(width, width)

    def forward(self, x: Tensor, places: Tensor, seen: Tensor) -> Tensor:
        split = self.qkv(x).unflatten(-1, (3, -1, HEAD)).permute(2, 0, 3, 1, 4)
        query, key, value = split.unbind(0)
        query, key = turn_by_place(query, places), turn_by_place(key, places)
        mixed = functional.scaled_dot_product_attention(query, key, value, attn_mask=seen)
        return self.proj(mixed.transpose(1, 2).flatten(-2))


def turn_by_place(x: Float[Tensor, "n g m e"], places: Float[Tensor, "m d"]) -> Tensor:
    """Queries or keys with equal even parts turned by each coordinate; the rest is left."""
    part = 2 * (x.shape[-1] // places.shape[-1] // 2)
    cut = part * places.shape[-1]
    parts = zip(x[..., :cut].split(part, -1), places.unbind(-1), strict=True)
    return torch.cat([*(rotate(p, place) for p, place in parts), x[..., cut:]], -1)


def rotate(x: Float[Tensor, "*n m e"], place: Float[Tensor, " m"]) -> Float[Tensor, "*n m e"]:
    """Neighbouring channels turned as pairs, by the angles that the release was trained with.

    Its angles run once over the first half of the channels and again over the second, not pair by
    pair, so that the two of a pair are turned by different angles.
    """
    half = x.shape[-1] // 2
    rate = 10_000.0 ** (-torch.arange(half, dtype=x.dtype, device=x.device) / half)
    angle = (place[:, None] * rate).repeat(1, 2)
    first, second = x.unflatten(-1, (-1, 2)).unbind(-1)
    turned = torch.stack([-second, first], -1).flatten(-2)
    return x * angle.cos() + turned * angle.sin()


def _places(frames: int, grid: tuple[int, int]) -> Float[Tensor, "m 3"]:
    """(time, row, column) of each token; row and column 0 of those beside the patches."""
    row, column = torch.meshgrid(*(torch.arange(n, device="cpu") for n in grid), indexing="ij")
    patches = torch.stack([row, column], -1).flatten(0, 1)
    frame = torch.cat([patches.new_zeros(EXTRA, 2), patches])
    time = torch.arange(frames, device="cpu").repeat_interleave(len(frame))
    return torch.cat([time[:, None], frame.repeat(frames, 1)], -1).float()


def _up_to_now(frames: int, tokens: int) -> Bool[Tensor, "m m"]:
    """Which tokens a token sees: all of its own frame and of those before."""
    time = torch.arange(frames, device="cpu").repeat_interleave(tokens)
    return time[:, None] >= time
