"""A multilayer perceptron whose input gradient is written out.

Forces are gradients of potentials. Writing the backward pass out as ordinary tensor operations
gives the force without an autograd graph in rollouts, and one single backward in training.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import ClassVar, cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.activations import SILU, SOFTPLUS, TANH

# (network, rows) -> the same numbers as torch's operations give, or None where it does not know
# such a network or such rows.
Engine = Callable[["MLP", Tensor], Tensor | None]


class MLP(nn.Module):
    """Linear layers with one smooth activation between them.

    Args:
        sizes: widths from input to output, e.g. ``(2, 64, 64, 1)``.
        activation: ``tanh`` (default for potentials: twice differentiable, and the most accurate
            force in our pilots), ``softplus`` or ``silu``.

    Attributes:
        output_engine, gradient_engine: of the class: faster ways to the output and to the gradient
            of many rows, see :mod:`dynamics.engines`.

    Example:
        >>> network = MLP((2, 8, 1), TANH)
        >>> x = torch.ones(5, 2, requires_grad=True)
        >>> (slope,) = torch.autograd.grad(network(x).sum(), x)
        >>> torch.allclose(network.gradient(x), slope, atol=1e-6)
        True
    """

    output_engine: ClassVar[Engine | None] = None
    gradient_engine: ClassVar[Engine | None] = None

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

    def split(self) -> tuple[Sequence[nn.Linear], nn.Linear]:
        """The hidden layers and the last one."""
        *hidden, last = cast(Sequence[nn.Linear], self.layers)
        return hidden, last

    @property
    def is_two_tanh_layers(self) -> bool:
        """Whether the hidden layers are two, of one width, and tanh: what fused loops know."""
        sizes = [layer.out_features for layer in self.split()[0]]
        return self.activation == TANH and len(sizes) == 2 and sizes[0] == sizes[1]

    def forward(self, x: Float[Tensor, "*b i"]) -> Float[Tensor, "*b o"]:
        """``(..., sizes[0]) -> (..., sizes[-1])``."""
        batch, x = x.shape[:-1], _rows(x)
        engine = type(self).output_engine
        found = engine(self, x) if engine else None
        out = self.plain_forward(x) if found is None else found
        return out.reshape(*batch, out.shape[-1])

    def plain_forward(self, x: Float[Tensor, "*b i"]) -> Float[Tensor, "*b o"]:
        """:meth:`forward` of rows by torch's own operations."""
        value, _ = _ACTIVATIONS[self.activation]
        hidden, last = self.split()
        for layer in hidden:
            x = value(layer(x))
        return last(x)

    def gradient(
        self, x: Float[Tensor, "*b i"], weights: Float[Tensor, "*b o"] | None = None
    ) -> Float[Tensor, "*b i"]:
        """Gradient with respect to the input, shape of ``x``.

        Of the single output, or of the sum of several with ``weights``, ``(..., sizes[-1])``.
        """
        shape, x = x.shape, _rows(x)
        engine = type(self).gradient_engine if weights is None else None
        found = engine(self, x) if engine else None
        return (self.plain_gradient(x, weights) if found is None else found).reshape(shape)

    def plain_gradient(
        self, x: Float[Tensor, "*b i"], weights: Tensor | None = None
    ) -> Float[Tensor, "*b i"]:
        """:meth:`gradient` of rows ``(rows, sizes[0])`` by torch's own operations."""
        value, slope = _ACTIVATIONS[self.activation]
        hidden, last = self.split()
        slopes = []
        for layer in hidden:
            pre = layer(x)
            x = value(pre)
            slopes.append(slope(pre, x))
        gradient = last.weight[0] if weights is None else _rows(weights) @ last.weight
        for layer, s in zip(reversed(hidden), reversed(slopes), strict=True):
            gradient = (gradient * s) @ layer.weight
        return gradient

    def pushforward(
        self, x: Float[Tensor, "*b i"], direction: Float[Tensor, "*b i"]
    ) -> Float[Tensor, "*b o"]:
        """Rate of the outputs while the input moves along ``direction``, ``(..., sizes[-1])``."""
        value, slope = _ACTIVATIONS[self.activation]
        hidden, last = self.split()
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
