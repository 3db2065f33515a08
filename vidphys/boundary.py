"""JSON that somebody else may have written: closed, typed, bounded and not deep, or refused."""

from __future__ import annotations

import stat
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from vidphys.errors import InputError

MAX_BYTES = 2**26
LARGEST = 1e15  # of a number that a person could mean

Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Above = Annotated[float, Field(gt=0, le=LARGEST)]
Word = Annotated[str, Field(max_length=200)]
Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class Closed(BaseModel):
    """What a file holds: no key more, each of its own type, numbers that are numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


File = TypeVar("File", bound=BaseModel)


def read_json(path: Path, kind: type[File], what: str) -> File:
    """The content of a JSON file.

    Args:
        path: of the file.
        kind: what it has to hold.
        what: it is, with its article, for a person.

    Raises:
        InputError: it cannot be read, is larger than any such file, deeper than 200, or holds
            something else; the first field that is wrong is named.
    """
    try:
        about = path.stat()
        if not stat.S_ISREG(about.st_mode):
            raise InputError(f"{path}: not a file")
        if about.st_size > MAX_BYTES:
            raise InputError(f"{path}: not {what} (more than {MAX_BYTES >> 20} MiB)")
        return kind.model_validate_json(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    except ValidationError as error:
        raise InputError(f"{path}: not {what} ({said(error)})") from error


def is_below(file: Path, folder: Path) -> bool:
    """Whether a file lies in a folder, wherever links lead."""
    return file.resolve().is_relative_to(folder.resolve())


def said(error: ValidationError, whole: str = "all of it") -> str:
    """The first thing that is wrong, by the name of its field.

    Args:
        error: what pydantic found.
        whole: what to call that which was checked.
    """
    found = error.errors(include_url=False, include_context=False)
    first = found[0]
    if first["type"] == "value_error":
        return first["msg"].removeprefix("Value error, ")
    where = ".".join(map(str, first["loc"])) or whole
    held = first["input"]
    value = f" {held!r}" if isinstance(held, str | int | float) and len(repr(held)) < 60 else ""
    more = f"; {len(found) - 1} more" if len(found) > 1 else ""
    return f"{where}{value}: {' '.join(first['msg'].split())}{more}"
