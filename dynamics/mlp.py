"""A multilayer perceptron whose input gradient is written out.

Forces are gradients of potentials. Writing the backward pass out as ordinary tensor operations
gives the force without an autograd graph in rollouts, and one single backward in training.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import cast

import torch
from torch import Tensor, nn

from loops import has_numba

FEWEST_ROWS = 64  # fewer are left to torch
TANH, SOFTPLUS, SILU = "tanh", "softplus", "silu"


class MLP(nn.Module):
    """Linear layers with one smooth activation between them.

    Args:
        sizes: widths from input to output, e.g. ``(2, 64, 64, 1)``.
        activation: ``tanh`` (default for potentials: twice differentiable, and the most accurate
            force in our pilots), ``softplus`` or ``silu``.
    """

    def __init__(self, sizes: tuple[int, ...], activation: str = TANH) -> None:
        super().__init__()
        if activation not in _ACTIVATIONS:
            raise ValueError(
                f"MLP: unknown activation '{activation}'; known: {', '.join(_ACTIVATIONS)}"
            )
        self.activation = activation
        self.layers = nn.ModuleList(
            nn.Linear(a, b) for a, b in zip(sizes[:-1], sizes[1:], strict=True)
        )

    def _split(self) -> tuple[Sequence[nn.Linear], nn.Linear]:
        """The hidden layers and the last one."""
        *hidden, last = cast(Sequence[nn.Linear], self.layers)
        return hidden, last

    def forward(self, x: Tensor) -> Tensor:
        """``(..., sizes[0]) -> (..., sizes[-1])``."""
        batch, x = x.shape[:-1], _rows(x)
        out = self.plain_forward(x) if torch.is_grad_enabled() else self._fused_forward(x)
        return out.reshape(*batch, out.shape[-1])

    def plain_forward(self, x: Tensor) -> Tensor:
        """:meth:`forward` of rows by torch's own operations."""
        value, _ = _ACTIVATIONS[self.activation]
        hidden, last = self._split()
        for layer in hidden:
            x = value(layer(x))
        return last(x)

    def _fused_forward(self, x: Tensor) -> Tensor:
        """The same of many rows by fused loops, which have no way back, where there are any."""
        weights = self._weights(x)
        if weights is None or torch._C._functorch.peek_interpreter_stack() is not None:
            return self.plain_forward(x)
        from dynamics.compiled.gradient import output

        return output(x, *weights) + self._split()[1].bias

    def gradient(self, x: Tensor, weights: Tensor | None = None) -> Tensor:
        """Gradient with respect to the input, shape of ``x``.

        Of the single output, or of the sum of several with ``weights``, ``(..., sizes[-1])``.
        """
        shape, x = x.shape, _rows(x)
        if weights is None and (fused := self._fused(x)) is not None:
            return fused.reshape(shape)
        return self.plain_gradient(x, weights).reshape(shape)

    def _fused(self, x: Tensor) -> Tensor | None:
        """The gradient of many rows by fused loops; ``None`` where there are none for it."""
        weights = self._weights(x)
        if weights is None:
            return None
        from dynamics.compiled.gradient import input_gradient

        return input_gradient(x, *weights)

    def _weights(self, x: Tensor) -> tuple[Tensor, ...] | None:
        """What fused loops are given of this network; ``None`` where they know no such rows."""
        hidden, last = self._split()
        sizes = [layer.out_features for layer in hidden]
        known = self.activation == TANH and len(sizes) == 2 and sizes[0] == sizes[1]
        if not known or last.out_features != 1 or len(x) < FEWEST_ROWS or not has_numba():
            return None
        from dynamics.compiled.gradient import can_run

        low, top = hidden
        given = low.weight, low.bias, top.weight, top.bias, last.weight
        return given if can_run(x) else None

    def plain_gradient(self, x: Tensor, weights: Tensor | None = None) -> Tensor:
        """:meth:`gradient` of rows ``(rows, sizes[0])`` by torch's own operations."""
        value, slope = _ACTIVATIONS[self.activation]
        hidden, last = self._split()
        slopes = []
        for layer in hidden:
            pre = layer(x)
            x = value(pre)
            slopes.append(slope(pre, x))
        gradient = last.weight[0] if weights is None else _rows(weights) @ last.weight
        for layer, s in zip(reversed(hidden), reversed(slopes), strict=True):
            gradient = (gradient * s) @ layer.weight
        return gradient

    def pushforward(self, x: Tensor, direction: Tensor) -> Tensor:
        """Rate of the outputs while the input moves along ``direction``, ``(..., sizes[-1])``."""
        value, slope = _ACTIVATIONS[self.activation]
        hidden, last = self._split()
        batch, x, rate = x.shape[:-1], _rows(x), _rows(direction)
        for layer in hidden:
            pre = layer(x)
            x = value(pre)
            rate = (rate @ layer.weight.T) * slope(pre, x)
        return (rate @ last.weight.T).reshape(*batch, last.out_features)


def _rows(x: Tensor) -> Tensor:
    """All batch axes as one: a single matrix product, also where models are mapped over."""
    return x.reshape(-1, x.shape[-1])


def _silu_slope(pre: Tensor, _: Tensor) -> Tensor:
    gate = torch.sigmoid(pre)
    return gate * (1 + pre * (1 - gate))


# name -> (function, its slope given the input and the output)
_ACTIVATIONS: dict[str, tuple[Callable[[Tensor], Tensor], Callable[[Tensor, Tensor], Tensor]]] = {
    TANH: (torch.tanh, lambda pre, out: 1 - out.square()),
    SOFTPLUS: (nn.functional.softplus, lambda pre, out: torch.sigmoid(pre)),
    SILU: (nn.functional.silu, _silu_slope),
}
