"""Pictures one after the other in one file: TIFF stacks of microscopes, animated WebP and PNG."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO, cast

from vidphys.data.formats.base import Frames
from vidphys.data.formats.opencv import decoded_apart

BEGINS = 64  # bytes, in which a WebP or PNG says that it moves
MOVES = 0x02  # of a WebP's features
TIFFS = {b"II*\0": "<", b"MM\0*": ">"}  # and their order of bytes
LARGE = {b"II+\0": "<", b"MM\0+": ">"}


def read_stack(path: Path) -> tuple[float, int, Frames]:
    """See :class:`vidphys.data.formats.ClipFormat`; Pillow decodes them.

    Raises:
        InputError: not pictures that Pillow can read, or ones that need more than they may.
    """
    return decoded_apart(path, "stack.py", "PIL")


def is_stack(path: Path) -> bool:
    """Whether a file is there and holds more than one picture, as its first bytes say."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        begins = file.read(BEGINS)
        if begins[:4] in TIFFS:
            return _more(file, TIFFS[begins[:4]], 4, "I", "H", 12)
        if begins[:4] in LARGE:
            return _more(file, LARGE[begins[:4]], 8, "Q", "Q", 20)
    if begins[8:16] == b"WEBPVP8X":
        return bool(begins[20] & MOVES)
    return begins[1:4] == b"PNG" and b"acTL" in begins


def _more(file: BinaryIO, order: str, at: int, place: str, count: str, entry: int) -> bool:
    """Whether a TIFF's first directory leads to another.

    Args:
        file: it.
        order: of bytes.
        at: where the place of the first directory stands.
        place, count: kinds of number that places and counts of entries are.
        entry: bytes of one.
    """
    try:
        file.seek(at)
        (first,) = _number(file, order + place)
        file.seek(first)
        (entries,) = _number(file, order + count)
        file.seek(entries * entry, 1)
        return bool(_number(file, order + place)[0])
    except (struct.error, OSError, OverflowError):
        return False


def _number(file: BinaryIO, kind: str) -> tuple[int]:
    return cast(tuple[int], struct.unpack(kind, file.read(struct.calcsize(kind))))
