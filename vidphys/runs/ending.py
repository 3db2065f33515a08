"""A process that is told to end (SIGINT, SIGTERM) keeps its work and ends soon, whatever it is at.

It imports nothing heavy, so that signals are heeded before anything else is loaded.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from types import FrameType, TracebackType

INTERRUPTED = 130
GRACE_SECONDS = 4.0
SIGNALS = (signal.SIGINT, signal.SIGTERM)
IMPORTING = "<frozen importlib._bootstrap>"
SAID = "interrupted; the same command goes on from here"


class Ending:
    """Inside, the first signal raises KeyboardInterrupt, and later ones do nothing.

    The process ends with :data:`INTERRUPTED` when ``grace`` seconds have passed since, even where
    the interrupt is not heeded (a long call of compiled code, somebody's ``except``). It does so at
    once in an import, which writes nothing and may swallow interrupts, and where no interrupt can
    come out (a function that C calls, an object's end): Python would print and forget it.
    Checkpoints and tables are whole at every instant, so there is nothing to wait for.

    Args:
        grace: seconds.
        said: what the process says when it ends.
        working: whether somebody takes the interrupt; until then the process ends at once.
    """

    def __init__(
        self, grace: float = GRACE_SECONDS, said: str = SAID, working: bool = True
    ) -> None:
        self.grace, self.said = grace, said
        self.asked = self.over = False
        self.working = working
        self._left = threading.Event()

    def __enter__(self) -> Ending:
        if threading.current_thread() is not threading.main_thread():
            return self
        reading, self._writing = os.pipe()
        os.set_blocking(self._writing, False)
        self._handlers = {number: signal.signal(number, self._heed) for number in SIGNALS}
        self._unraisable, sys.unraisablehook = sys.unraisablehook, self._forgotten
        # Written to by the signal itself: no bytecode need run for the watch to wake.
        self._before = signal.set_wakeup_fd(self._writing, warn_on_full_buffer=False)
        threading.Thread(target=self._watch, args=(reading,), daemon=True).start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if hasattr(self, "_handlers"):
            signal.set_wakeup_fd(self._before)
            sys.unraisablehook = self._unraisable
            for number, handler in self._handlers.items():
                signal.signal(number, handler)
            self._left.set()
            os.close(self._writing)

    def interrupted(self) -> int:
        """Say so, and give the exit code."""
        self.asked, said, self.said = True, self.said, ""
        print(said, file=sys.stderr, flush=True)
        return INTERRUPTED

    def _heed(self, _number: int, frame: FrameType | None) -> None:
        if self.asked or self.over:
            return
        self.asked = True
        if not self.working or _is_importing(frame):
            self._leave()
        raise KeyboardInterrupt

    def _forgotten(self, raised: sys.UnraisableHookArgs) -> None:
        if self.asked and isinstance(raised.exc_value, KeyboardInterrupt):
            self._leave()
        self._unraisable(raised)

    def _watch(self, reading: int) -> None:
        while (told := os.read(reading, 1)) and told[0] not in SIGNALS:
            pass
        if told and not self._left.wait(self.grace):
            self._leave()
        os.close(reading)  # last: later signals are written too

    def _leave(self) -> None:
        if self.said:  # past Python's own files, which the main thread may be holding
            os.write(2, f"{self.said}\n".encode())
        os._exit(INTERRUPTED)


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == IMPORTING:
            return True
        frame = frame.f_back
    return False
