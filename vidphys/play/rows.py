"""Of each episode: how far it ended from the truth, how near bodies came, how energy drifts."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from dynamics import Parameters, PhaseState
from vidphys.play.stage import Stage


def table(
    stage: Stage, params: Parameters, model: PhaseState | None, truth: PhaseState | None
) -> dict[str, list[float | None]]:
    """Columns of a table of episodes; what is not finite is ``None``.

    Args:
        stage: whose episodes, with its scene.
        params: of each.
        model: their states, ``(e, t, n, d)``.
        truth: the same, at the same instants as far as it goes; ``None`` where it is not known.
    """
    scene = stage.scene
    assert scene is not None and model is not None
    rows, seen = {}, model
    if truth is not None:
        both, seen = min(model.q.shape[1], truth.q.shape[1]), truth
        apart = (model.q[:, :both].double() - truth.q[:, :both]).norm(dim=-1).mean(-1)
        rows["error"] = numbers(stage.view.length * apart.mean(1))
        rows["end"] = numbers(stage.view.length * apart[:, -1])
        energy = scene.energy(model, params)
        scale = scene.energy_scale(model.map(lambda x: x[:, 0]), params)
        rows["drift"] = numbers((energy - energy[:, :1]).abs().amax(1) / scale)
    rows["closest"] = numbers(stage.view.length * _closest(seen.q))
    rows["coupling"] = numbers(params.coupling)
    return rows


def numbers(x: Tensor) -> list[float | None]:
    """Of a tensor of one axis, as JSON has them."""
    return [v if math.isfinite(v) else None for v in x.double().tolist()]


def _closest(q: Tensor) -> Tensor:
    if q.shape[-2] < 2:
        return q.new_full(q.shape[:1], torch.inf)
    i, j = torch.triu_indices(q.shape[-2], q.shape[-2], offset=1)
    apart = (q[..., i, :] - q[..., j, :]).norm(dim=-1)
    return apart.nan_to_num(torch.inf).amin((-2, -1))
