"""One process at a time in a folder: the lock is a plain file in it, and never somebody's link."""

from __future__ import annotations

import fcntl
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vidphys.errors import InputError

LOCK = ".lock"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold ``folder``, which is made where there is none, for this process.

    The lock's file is neither followed, where it is a link, nor emptied.

    Raises:
        InputError: another process is at work in it, or nothing can be written there.
    """
    held = _take(folder)
    try:
        yield
    finally:
        os.close(held)


def _take(folder: Path) -> int:
    path = folder / LOCK
    while True:
        held = _open(folder)
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_still(path, held):
                return held
        except BlockingIOError as error:
            os.close(held)
            raise InputError(
                f"run folder {folder}: another process is at work in it; wait for it, or "
                "choose another folder"
            ) from error
        except BaseException:
            os.close(held)
            raise
        os.close(held)  # of a run that was abandoned meanwhile, whose lock went with it


def _open(folder: Path) -> int:
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / LOCK).is_symlink():
            raise InputError(f"run folder {folder}: its {LOCK} is a link; remove the link")
        held = os.open(folder / LOCK, flags, 0o666)
    except OSError as error:
        raise InputError(
            f"run folder {folder}: cannot be written ({error.strerror}); choose another"
        ) from error
    if not stat.S_ISREG(os.fstat(held).st_mode):
        os.close(held)
        raise InputError(f"run folder {folder}: its {LOCK} is not a plain file; remove it")
    return held


def _is_still(path: Path, held: int) -> bool:
    try:
        return os.path.samestat(path.lstat(), os.fstat(held))
    except FileNotFoundError:
        return False
