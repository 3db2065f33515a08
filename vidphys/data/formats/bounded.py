"""What a file of somebody else's may take up, told from its headers before anything is held."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import prod
from pathlib import Path
from stat import S_ISLNK
from zipfile import ZipFile

from vidphys.errors import InputError

MOST_BYTES = 2**29  # of numbers that are held
MOST_TEXT = 2**26  # bytes of a text, or of an XML
MOST_COLUMNS = 4096
MOST_MEMBERS = 10_000  # of an archive
LONGEST_NAME = 300  # characters of the name of a column
PIECE = 2**20  # bytes that are unpacked at once where they are only counted


@contextmanager
def reading(what: str) -> Iterator[None]:
    """Whatever a library says of a file that it cannot read, as one line.

    Args:
        what: the file should have been, with its article.

    Raises:
        InputError: the block raised; an error of this kind passes as it is.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        said = str(error).strip().splitlines()[:1] or [type(error).__name__]
        raise InputError(f"not {what} ({said[0][:200]})") from error


def require_room(shape: Sequence[int], each: int, what: str) -> None:
    """Refuse an array that is too large to be a recording.

    Args:
        shape: of it.
        each: bytes of a number.
        what: it is.

    Raises:
        InputError: it would fill more than :data:`MOST_BYTES`.
    """
    if min(shape, default=0) < 0 or prod(map(int, shape)) * each > MOST_BYTES:
        raise InputError(
            f"{what} of {' x '.join(map(str, shape))} numbers would fill more than "
            f"{MOST_BYTES >> 20} MiB; give fewer of them"
        )


def require_text(path: Path) -> None:
    """Refuse a text that is too large.

    Raises:
        InputError: it has more than :data:`MOST_TEXT` bytes.
    """
    if path.stat().st_size > MOST_TEXT:
        raise InputError(
            f"more than {MOST_TEXT >> 20} MiB of text; give fewer rows, or a Parquet or NPZ"
        )


def unpacked(archive: ZipFile, ending: str) -> bytes | None:
    """The first file in an archive whose name ends so, ``None`` where there is none.

    It is unpacked into memory, so that its name leads nowhere.

    Raises:
        InputError: too many members, a link, or more bytes than :data:`MOST_TEXT`.
    """
    members = archive.infolist()
    if len(members) > MOST_MEMBERS:
        raise InputError(f"{len(members)} files in this archive, more than {MOST_MEMBERS}")
    for member in members:
        if not member.filename.lower().endswith(ending) or member.is_dir():
            continue
        if S_ISLNK(member.external_attr >> 16):
            raise InputError(f"{member.filename!a} in this archive is a link; pack the file")
        with archive.open(member) as file:
            data = file.read(MOST_TEXT + 1)
        if len(data) > MOST_TEXT:
            raise InputError(
                f"{member.filename!a} in this archive has more than {MOST_TEXT >> 20} MiB"
            )
        return data
    return None


def require_packed(data: memoryview) -> None:
    """Unpack a stream of zlib in pieces, only to count.

    Raises:
        InputError: it has more than :data:`MOST_BYTES`.
    """
    stream, count, rest = zlib.decompressobj(), 0, bytes(data)
    while rest and not stream.eof:
        count += len(stream.decompress(rest, PIECE))
        rest = stream.unconsumed_tail
        if count > MOST_BYTES:
            raise InputError(f"more than {MOST_BYTES >> 20} MiB when unpacked")
