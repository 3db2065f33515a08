"""What a card computes again and again, recorded once and played again (CUDA graphs).

A small model's step is dozens of kernels, each of which takes less time than asking for it; a
recording asks for all of them at once. What Python decides while it is recorded is decided for
good, and nothing in it may wait for the card.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from dynamics.head import Head
from dynamics.state import Parameters, PhaseState


def recorded(work: Callable[[], Any]) -> Callable[[], Any]:
    """What computes the same again, in the same memory, and gives the same tensors back.

    Args:
        work: has run before, in a stream of its own (:func:`apart`), so that libraries have chosen
            and set up their kernels.

    Raises:
        RuntimeError: it does what cannot be recorded.
    """
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        found = work()

    def play() -> Any:
        graph.replay()
        return found

    return play


def apart(work: Callable[[], Any], times: int) -> None:
    """Run something in a stream of its own, where nothing else is under way."""
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        for _ in range(times):
            work()
    torch.cuda.current_stream().wait_stream(stream)


def stepped(
    head: Head, start: PhaseState, params: Parameters, steps: int, dt: float, every: int
) -> PhaseState | None:
    """:func:`dynamics.head.stepped` by a recorded step.

    Returns:
        ``None`` where what a step hands over to the next is more than one tensor.

    Raises:
        RuntimeError: the head's step cannot be recorded.
    """
    state, memory = head.advance(start, params, dt, None)
    if not (memory is None or isinstance(memory, Tensor)):
        return None
    first = [x for x in (state.q, state.p, memory) if x is not None]
    now = [x.clone() for x in first]

    def step() -> None:
        state, memory = head.advance(PhaseState(*now[:2]), params, dt, *now[2:])
        for old, new in zip(now, (state.q, state.p, memory), strict=False):
            old.copy_(new)

    apart(step, 2)
    torch._foreach_copy_(now, first)
    play = recorded(step)
    q, p = (x.new_empty(steps // every + 1, *x.shape) for x in (start.q, start.p))
    q[0], p[0] = start.q, start.p
    for number in range(1, steps + 1):
        if number > 1:
            play()
        if number % every == 0:
            q[number // every], p[number // every] = now[0], now[1]
    return PhaseState(*(x.movedim(0, -3) for x in (q, p)))
