"""How far a long piece of work is: what everything that takes a while is given to call."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[int, int, float], None]
"""Called as ``(step, steps, loss)``; the loss is 0 where nothing is learned."""
