"""Who works on which unit, told by files in a folder that all workers see: no server.

::

    FOLDER/workers/<worker>      rewritten while that worker lives, removed when it leaves
    FOLDER/claims/<unit>.<n>     names the n-th worker that took the unit

A unit is taken by creating a name that must not be there yet (``O_EXCL``). Its owner holds it for
a lease, which is renewed whenever its own file changes. Another worker takes the unit over, by the
next ``n``, once it has watched that file for a whole lease by its own clock without a change:
clocks of machines are never compared. An owner that could not renew in time has lost all it held,
also where nobody has taken it over yet. Two may still believe for a moment that a unit is theirs,
so that what they make has to be put in its place by an operation that only the first can do.
"""

from __future__ import annotations

import json
import os
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

from vidphys.errors import InputError

LEASE = 60.0  # seconds
BEATS = 6  # renewals in a lease
LOOKS = 20  # looks at what others hold, in a lease
MOST_POLL = 2.0  # seconds between looks


class ClaimLost(Exception):
    """The worker could not renew its lease in time, so that its unit may be another's by now."""


@dataclass(frozen=True)
class Claim:
    """A unit that this worker holds.

    Args:
        unit: its number.
        take: which taking of the unit it is, from 1.
        held: whether the lease still runs.
    """

    unit: int
    take: int
    held: Callable[[], bool] = field(repr=False)

    def require(self) -> None:
        """Go on only while the unit is held.

        Raises:
            ClaimLost: it is not.
        """
        if not self.held():
            raise ClaimLost(f"unit {self.unit}: the lease ran out before it was renewed")


class Claims:
    """The units that this worker takes; a context, in which its lease is renewed by a thread.

    Args:
        folder: seen by all workers.
        lease: seconds without a renewal after which others may take a unit over.

    Raises:
        InputError: a lease that is not above 0.
    """

    def __init__(self, folder: Path, lease: float = LEASE) -> None:
        if not lease > 0:
            raise InputError(f"`lease` {lease:g}: must be above 0 seconds")
        self.folder, self.lease, self.worker = folder, lease, uuid.uuid4().hex
        self._own = folder / "workers" / self.worker
        self._stop = threading.Event()
        self._lock = threading.Lock()
        self._beats = self._lost = 0
        self._watched: dict[str, tuple[bytes, float]] = {}

    def __enter__(self) -> Claims:
        for part in ("workers", "claims"):
            (self.folder / part).mkdir(parents=True, exist_ok=True)
        self._renewed = time.monotonic()
        self._renew()
        self._thread = threading.Thread(target=self._beat, daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop.set()
        self._thread.join()
        self._own.unlink(missing_ok=True)  # others need not wait for the lease to run out

    def take(self, unit: int) -> Claim | None:
        """The unit, unless another worker holds it."""
        last = 0
        while self._named(unit, last + 1).exists():
            last += 1
        if last and not self._left(self._named(unit, last)):
            return None
        try:
            if not self._runs():
                self._renew()
            lost = self._lost
            if not self._create(self._named(unit, last + 1)):
                return None
        except FileNotFoundError:  # another found that all is done, and tidied up
            return None
        return Claim(unit, last + 1, lambda: self._runs() and self._lost == lost)

    def each(self, units: Sequence[int], done: Callable[[int], bool]) -> Iterator[Claim]:
        """One unit after the other, until all are done by whomever.

        Args:
            units: their numbers. Every worker begins at another one.
            done: whether a unit is. Once all are, the folder may be deleted.

        Raises:
            InputError: the folder was deleted before.
        """
        first = int(self.worker, 16) % max(1, len(units))
        open_ = [*units[first:], *units[:first]]
        while open_:
            left = []
            for unit in open_:
                if done(unit):
                    continue
                claim = self.take(unit)
                if claim is not None:
                    yield claim
                elif not self._own.exists() and not done(unit):
                    raise InputError(f"{self.folder}: was deleted while units were being made")
                left += [] if done(unit) else [unit]
            if len(left) == len(open_):
                time.sleep(min(self.lease / LOOKS, MOST_POLL))
            open_ = left

    def _named(self, unit: int, take: int) -> Path:
        return self.folder / "claims" / f"{unit:06d}.{take}"

    def _create(self, path: Path) -> bool:
        about = {"worker": self.worker, "lease": self.lease}
        try:
            number = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            return False
        with os.fdopen(number, "w", encoding="utf-8") as file:
            file.write(json.dumps({**about, "pid": os.getpid()}))
        return True

    def _left(self, claim: Path) -> bool:
        """Whether the owner of a claim has left, or was silent for its lease while we watched."""
        owner, lease = self._owner(claim)
        if owner == self.worker:
            return True  # lost, for it takes one only when it is done with the last
        try:
            said = (claim.parents[1] / "workers" / owner).read_bytes() if owner else b""
        except FileNotFoundError:
            return True
        before, since = self._watched.get(claim.name, (None, 0.0))
        now = time.monotonic()
        if said != before:
            self._watched[claim.name] = said, now
            return False
        return now - since > lease

    def _owner(self, claim: Path) -> tuple[str, float]:
        """The worker that a claim names and its lease; no name where it died while writing it."""
        try:
            about = json.loads(claim.read_text(encoding="utf-8"))
            worker, lease = about["worker"], float(about["lease"])
            return (worker, lease) if worker.isalnum() else ("", self.lease)
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return "", self.lease

    def _beat(self) -> None:
        while not self._stop.wait(self.lease / BEATS):
            with suppress(OSError):  # the folder cannot be reached for a while: tried again
                self._renew()

    def _renew(self) -> None:
        begun = time.monotonic()
        self._runs()
        self._own.write_text(str(self._beats), encoding="utf-8")
        with self._lock:
            self._beats, self._renewed = self._beats + 1, begun

    def _runs(self) -> bool:
        """Whether the lease runs; once it does not, all that was taken before is lost."""
        with self._lock:
            over = time.monotonic() - self._renewed > self.lease
            self._lost += over
            return not over
