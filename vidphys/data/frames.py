"""Frames of a clip, decoded when they are asked for; only those of a short clip are held.

Decoding again is cheaper than memory: what needs every frame takes them one after the other, or in
blocks, and each time is a decoding of its own.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import overload

import numpy as np

from vidphys.data.memory import require_memory

HELD = 2**28  # bytes of a clip, up to which it is held
CHUNK = 2**24  # bytes of a block
BLANK = 160  # pixels of a side of a recording's pictures where there is no clip
RECENT = 2**25  # bytes of frames that were asked for last

Decode = Callable[[], Iterator[np.ndarray]]
Held = list[np.ndarray] | np.ndarray


class Frames:
    """Some frames of a clip, as an array ``(t, H, W, 3)`` of bytes would give them.

    Frames that are asked for by number are cheap in rising order; ``numpy.asarray`` decodes all.

    Args:
        source: what decodes them.
        numbers: which of its frames; all where not given.

    Example:
        >>> frames = held(np.zeros((5, 4, 6, 3), np.uint8))
        >>> len(frames), frames[1:4].shape, frames[-1].shape, len([*frames.chunks(150)])
        (5, (3, 4, 6, 3), (4, 6, 3), 3)
    """

    dtype = np.dtype(np.uint8)
    ndim = 4

    def __init__(self, source: Source, numbers: range | None = None) -> None:
        self._source = source
        self._numbers = range(source.count) if numbers is None else numbers

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """``(t, H, W, 3)``."""
        return len(self._numbers), *self._source.size, 3

    def __len__(self) -> int:
        return len(self._numbers)

    @property
    def held(self) -> bool:
        """Whether they are in memory already."""
        return self._source.held is not None

    @property
    def released(self) -> Frames:
        """The same, decoded anew when they are asked for."""
        source = self._source
        return Frames(Source(source.decode, source.count, source.size), self._numbers)

    def __iter__(self) -> Iterator[np.ndarray]:
        n = self._numbers
        return self._source.each(n.start, n.stop, n.step) if len(n) else iter(())

    @overload
    def __getitem__(self, which: int) -> np.ndarray: ...
    @overload
    def __getitem__(self, which: slice) -> Frames: ...
    @overload
    def __getitem__(self, which: Sequence[int]) -> np.ndarray: ...
    def __getitem__(self, which: int | slice | Sequence[int]) -> np.ndarray | Frames:
        """One frame, the frames of a forward slice (undecoded), or those of a list."""
        if isinstance(which, slice):
            if which.step is not None and which.step < 1:
                raise ValueError(f"frames: step {which.step}; decoding goes forward")
            return Frames(self._source, self._numbers[which])
        if isinstance(which, (int, np.integer)):
            return self._source.at(self._numbers[which])
        wanted = [self._numbers[k] for k in which]
        found = {k: self._source.at(k) for k in sorted(set(wanted))}
        return np.stack([found[k] for k in wanted])

    def __array__(self, dtype: object = None, copy: bool | None = None) -> np.ndarray:
        """All of them in memory.

        Raises:
            InputError: they are more than it holds.
        """
        n, known = self._numbers, self._source.held
        if isinstance(known, np.ndarray):
            return known[n.start : n.stop : n.step]
        size = int(np.prod(self.shape))
        if known is None:
            require_memory(size)
        return next(self.chunks(size), np.empty(self.shape, np.uint8))

    def chunks(self, most: int = CHUNK) -> Iterator[np.ndarray]:
        """Blocks ``(n, H, W, 3)`` of at most so many bytes, one frame at least, in order."""
        each, left = iter(self), len(self)
        count = max(1, most // int(np.prod(self.shape[1:])))
        while left:
            block = np.empty((min(count, left), *self.shape[1:]), np.uint8)
            for room, frame in zip(block, each, strict=False):
                room[:] = frame
            left -= len(block)
            yield block


class Source:
    """What decodes the frames of a clip.

    Args:
        decode: its frames ``(H, W, 3)``, from the first on, each time that it is called.
        count: of them.
        size: (height, width) of each.
        held: all of them, where they are.
    """

    def __init__(
        self, decode: Decode, count: int, size: tuple[int, int], held: Held | None = None
    ) -> None:
        self.decode, self.count, self.size, self.held = decode, count, size, held
        self._going: Iterator[tuple[int, np.ndarray]] = iter(())
        self._recent: deque[tuple[int, np.ndarray]] = deque()

    def each(self, start: int, stop: int, step: int) -> Iterator[np.ndarray]:
        """Frames one after the other, in one decoding."""
        if self.held is not None:
            return iter(self.held[start:stop:step])
        return islice(self.decode(), start, stop, step)

    def at(self, number: int) -> np.ndarray:
        """One frame; those before it are decoded as well, unless one was asked for just before."""
        if self.held is not None:
            return self.held[number]
        for known, frame in self._recent:
            if known == number:
                return frame
        if not self._recent or number < self._recent[-1][0]:
            self._recent.clear()
            self._going = enumerate(self.decode())
        most = max(1, RECENT // (3 * self.size[0] * self.size[1]))
        for here, frame in self._going:
            self._recent.append((here, frame))
            if len(self._recent) > most:
                self._recent.popleft()
            if here == number:
                return frame
        raise IndexError(f"frame {number} of {self.count}")


def held(frames: np.ndarray) -> Frames:
    """Frames ``(t, H, W, 3)`` that are in memory already."""
    return Frames(Source(lambda: iter(frames), len(frames), frames.shape[1:3], frames))


def blank(count: int) -> np.ndarray:
    """White pictures ``(count, h, w, 3)`` where there is no clip; in memory they are one byte."""
    return np.broadcast_to(np.uint8(255), (count, BLANK, BLANK, 3))


class Holding:
    """Frames of a clip as they come in, for as long as they are few enough to be held."""

    def __init__(self) -> None:
        self._frames: list[np.ndarray] | None = []
        self.size: tuple[int, int] | None = None

    def add(self, frame: np.ndarray) -> None:
        """One more, ``(H, W, 3)`` bytes.

        Raises:
            ValueError: of another size than the first.
        """
        size = frame.shape[0], frame.shape[1]
        self.size = self.size or size
        if size != self.size:
            raise ValueError(
                f"{size[1]} x {size[0]} pixels, the first was {self.size[1]} x {self.size[0]}"
            )
        if self._frames is not None:
            self._frames.append(frame)
            if len(self._frames) * frame.nbytes > HELD:
                self._frames = None

    def all(self) -> list[np.ndarray] | None:
        """Each of them, or nothing where they are too many."""
        return self._frames
