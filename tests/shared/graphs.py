"""What the graph of a tensor's way back consists of."""

from __future__ import annotations

from torch import Tensor


def goes_through(found: Tensor, name: str) -> bool:
    """Whether the way back, always to the first of what a node was made of, meets such a node."""
    node = found.grad_fn
    while node is not None and name not in type(node).__name__:
        node = node.next_functions[0][0] if node.next_functions else None
    return node is not None
