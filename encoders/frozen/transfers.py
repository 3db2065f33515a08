"""Frames to a card and features back, while the card computes.

A copy from ordinary memory makes the program wait for the card; one from memory that the system may
not move (pinned) does not, and on a stream of its own it runs beside what is computed.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import torch
from torch import Tensor

Maps = list[list[Tensor]]  # of each layer, of each window


def sent(frames: Tensor, device: torch.device) -> Tensor:
    """Frames on a device; what is computed there next waits for them, and this program does not."""
    if device.type != "cuda" or frames.device.type == "cuda":
        return frames.to(device)
    computing, beside = torch.cuda.current_stream(device), torch.cuda.Stream(device)
    with torch.cuda.stream(beside):
        there = frames.pin_memory().to(device, non_blocking=True)
    computing.wait_stream(beside)
    there.record_stream(computing)  # its memory is not given away before that is done with it
    return there


class Coming:
    """A pass, and its features: on a card it is only asked for until :meth:`maps` waits for it.

    Args:
        compute: the pass.
        device: where it runs.
    """

    def __init__(self, compute: Callable[[], Maps], device: torch.device) -> None:
        self.under_way = device.type == "cuda"
        self._events = [torch.cuda.Event(enable_timing=True) for _ in range(3 * self.under_way)]
        begun = time.perf_counter()
        self._note(0)
        found = compute()
        self._note(1)
        self._maps = [[_fetched(x) for x in maps] for maps in found] if self.under_way else found
        self._note(2)
        self._took = time.perf_counter() - begun

    def _note(self, number: int) -> None:
        if self.under_way:
            self._events[number].record()

    def maps(self) -> Maps:
        """Of each layer the features of each window, from a card on the CPU."""
        if self.under_way:
            self._events[2].synchronize()
        return self._maps

    @property
    def seconds(self) -> float:
        """That the network took, once :meth:`maps` was called."""
        if not self.under_way:
            return self._took
        return self._events[0].elapsed_time(self._events[1]) / 1e3


def _fetched(values: Tensor) -> Tensor:
    """Where values will be on the CPU, once the card has done what it was asked for till now."""
    here = torch.empty(values.shape, dtype=values.dtype, device="cpu", pin_memory=True)
    return here.copy_(values, non_blocking=True)
