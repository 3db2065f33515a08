"""Which clips a command means: files, folders, data sets, patterns, and lists of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from vidphys.data.dataset import clips_of
from vidphys.data.sets import is_in_set
from vidphys.errors import InputError

LIST = ".txt"  # a clip a line, relative to the list


def listed_clips(given: Sequence[Path]) -> list[Path]:
    """The clips, each once.

    Args:
        given: what :func:`vidphys.data.dataset.clips_of` takes, patterns such as ``clips/*.mp4``,
            or text files that name a clip a line; lines that begin with ``#`` are left out.

    Raises:
        InputError: nothing is there, or nothing in it is a clip.
    """
    found: dict[Path, None] = {}
    for place in given:
        found |= dict.fromkeys(clips_at(place))
    return list(found)


def clips_at(place: Path) -> Iterable[Path]:
    """The clips that one of them means; a list is read as it is gone through.

    Raises:
        InputError: see :func:`listed_clips`.
    """
    if place.suffix.lower() == LIST and place.is_file():
        return _of_list(place)
    if place.exists() or is_in_set(place):
        return clips_of(place)
    if any(sign in str(place) for sign in "*?["):
        fixed = next(each for each in place.parents if each.exists())
        files = sorted(file for file in fixed.glob(str(place.relative_to(fixed))) if file.is_file())
        if not files:
            raise InputError(f"extract: {place}: no file has such a name")
        return files
    raise InputError(f"extract: {place}: no such file; nothing was extracted")


def _of_list(place: Path) -> Iterator[Path]:
    named = False
    try:
        with place.open(encoding="utf-8") as lines:
            for number, line in enumerate(lines, 1):
                name = line.strip()
                if not name or name.startswith("#"):
                    continue
                clip = place.parent / name
                if not clip.is_file() and not is_in_set(clip):
                    raise InputError(f"extract: {place}, line {number}: no clip {clip}")
                named = True
                yield clip
    except UnicodeDecodeError as error:
        raise InputError(f"extract: {place}: a list of clips must be UTF-8 ({error})") from error
    if not named:
        raise InputError(f"extract: {place}: names no clip")
