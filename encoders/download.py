"""One file from a plain web address, gone on with where it broke off."""

from __future__ import annotations

import http.client
import json
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

BLOCK = 2**20  # bytes
PATIENCE = 60.0  # seconds without a byte

Show = Callable[[int, int], None]


def download(url: str, target: Path, show: Show | None = None) -> Path:
    """Fetch a file to ``target``; what came before is kept beside it and not fetched again.

    A part is gone on with only where the server says that the file is still the same one.

    Args:
        url: of the file.
        target: where it is put once it is whole.
        show: called as ``(bytes there, bytes in all)``.

    Raises:
        ConnectionError: it did not come, or not whole; the same call goes on with it.
    """
    part, tag = (target.with_name(f".{target.name}.{what}") for what in ("part", "tag"))
    there, known = (part.stat().st_size, _read(tag)) if part.is_file() else (0, None)
    request = urllib.request.Request(url)
    if there and known is not None:
        request.add_header("Range", f"bytes={there}-")
        request.add_header("If-Range", known)
    try:
        with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
            goes_on = answer.status == 206
            done = there if goes_on else 0
            whole = done + int(answer.headers.get("Content-Length") or 0)
            if not goes_on:
                tag.write_text(json.dumps(answer.headers.get("ETag")), encoding="utf-8")
            with part.open("ab" if goes_on else "wb") as file:
                while block := answer.read(BLOCK):
                    done += file.write(block)
                    if show is not None:
                        show(done, whole)
    except urllib.error.HTTPError as error:
        if error.code == 416:  # the part is no beginning of what is there now
            part.unlink(missing_ok=True)
        raise ConnectionError(f"{url}: {error}") from error
    except (OSError, http.client.HTTPException) as error:
        raise ConnectionError(f"{url}: {error}; the same command goes on with it") from error
    if done < whole:
        raise ConnectionError(
            f"{url}: broke off after {done} of {whole} bytes; the same command goes on with it"
        )
    part.replace(target)
    tag.unlink(missing_ok=True)
    return target


def _read(tag: Path) -> str | None:
    """What the server called the file that a part is of; ``None`` where it said nothing."""
    try:
        said: Any = json.loads(tag.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return said if isinstance(said, str) and said.startswith('"') else None
