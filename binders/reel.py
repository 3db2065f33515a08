"""Pictures of one size that are looked at in any order: in memory while few, else in a file.

The file has no name, so that nothing is left of it, and is read and not mapped, so that it counts
in nobody's memory.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from operator import index
from typing import IO, SupportsIndex, overload

import numpy as np

from binders.base import Pictures

HELD = 2**26  # bytes of a reel, up to which it is in memory
RECENT = 4  # pictures that went through a function last


class Reel:
    """So many pictures ``(h, w, …)``, appended one by one.

    Args:
        shape: of each.
        dtype: of each.

    Example:
        >>> reel = filled(np.full((2, 3), k) for k in range(4))
        >>> reel.shape, reel[2].tolist(), reel[[3, 0]].shape
        ((4, 2, 3), [[2, 2, 2], [2, 2, 2]], (2, 2, 3))
    """

    def __init__(self, shape: tuple[int, ...], dtype: np.dtype) -> None:
        self._each, self.dtype = shape, dtype
        self._size = int(np.prod(shape)) * dtype.itemsize
        self._held: list[np.ndarray] = []
        self._file: IO[bytes] | None = None
        self._count = 0

    @property
    def shape(self) -> tuple[int, ...]:
        """``(t, h, w, …)``."""
        return self._count, *self._each

    def __len__(self) -> int:
        return self._count

    def append(self, picture: np.ndarray) -> None:
        """One more at the end.

        Raises:
            OSError: no room for the file.
        """
        if self._file is None and (self._count + 1) * self._size > HELD:
            self._file = tempfile.TemporaryFile(prefix="vidphys-")  # noqa: SIM115 - ends with us
            for known in self._held:
                self._write(known)
            self._held.clear()
        if self._file is None:
            self._held.append(picture)
        else:
            self._write(picture)
        self._count += 1

    def _write(self, picture: np.ndarray) -> None:
        assert self._file is not None
        self._file.write(np.ascontiguousarray(picture, self.dtype).data)
        self._file.flush()

    @overload
    def __getitem__(self, which: SupportsIndex) -> np.ndarray: ...
    @overload
    def __getitem__(self, which: Sequence[int]) -> np.ndarray: ...
    def __getitem__(self, which: SupportsIndex | Sequence[int]) -> np.ndarray:
        """One picture, which is not to be changed, or several in an array of their own."""
        if isinstance(which, Sequence):
            return np.stack([self[k] for k in which])
        number = range(self._count)[which]
        if self._file is None:
            return self._held[number]
        picture = np.empty(self._each, self.dtype)
        os.preadv(self._file.fileno(), [picture.data.cast("B")], number * self._size)
        return picture

    def __iter__(self) -> Iterator[np.ndarray]:
        return (self[k] for k in range(self._count))


def filled(pictures: Iterable[np.ndarray]) -> Reel:
    """A reel of one picture at least."""
    reel: Reel | None = None
    for picture in pictures:
        reel = reel or Reel(picture.shape, picture.dtype)
        reel.append(picture)
    assert reel is not None
    return reel


class Through:
    """Pictures through a function, when they are asked for.

    Args:
        pictures: a reel, or an array.
        function: of one picture.
    """

    def __init__(self, pictures: Pictures, function: Callable[[np.ndarray], np.ndarray]) -> None:
        self._count = len(pictures)
        self._one = lru_cache(RECENT)(lambda number: function(pictures[number]))

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, which: SupportsIndex) -> np.ndarray: ...
    @overload
    def __getitem__(self, which: Sequence[int]) -> np.ndarray: ...
    def __getitem__(self, which: SupportsIndex | Sequence[int]) -> np.ndarray:
        """One picture, or several in an array of their own."""
        if isinstance(which, Sequence):
            return np.stack([self[k] for k in which])
        found: np.ndarray = self._one(index(which))
        return found

    def __iter__(self) -> Iterator[np.ndarray]:
        return (self[k] for k in range(self._count))


class Masks:
    """Boolean pictures ``(t, h, w)``, a bit a pixel.

    Args:
        size: (height, width).
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self._size = size
        self._bits = Reel((-(-size[0] * size[1] // 8),), np.dtype(np.uint8))

    @property
    def shape(self) -> tuple[int, int, int]:
        """``(t, h, w)``."""
        return len(self._bits), *self._size

    def __len__(self) -> int:
        return len(self._bits)

    def __iter__(self) -> Iterator[np.ndarray]:
        return (self[k] for k in range(len(self)))

    def append(self, mask: np.ndarray) -> None:
        """One more at the end."""
        self._bits.append(np.packbits(mask))

    def __getitem__(self, number: SupportsIndex) -> np.ndarray:
        height, width = self._size
        bits = np.unpackbits(self._bits[number], count=height * width)
        return bits.view(bool).reshape(height, width)
