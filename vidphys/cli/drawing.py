"""What is drawn of a diagnosis, in a process that loads the libraries while the laws are fitted.

They take a second to load, and need nothing of the answer for that.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from vidphys.runs.worker import end_with_parent

if TYPE_CHECKING:
    from vidphys.data.frames import Frames
    from vidphys.diagnose.telling.answered import Answered

LIBRARIES = ("matplotlib.figure", "rerun")
STAYS = "it stays where it was"  # what is foretold where no law does
START = "import sys; sys.path[:] = sys.argv[1:]; import vidphys.cli.drawing as d; d.serve()"


@dataclass(frozen=True)
class Drawing:
    """A figure, and a recording for the viewer.

    Args:
        run: the run folder.
        figure: arguments of :func:`viz.diagnosis.diagnosis_figure`.
        arrays: see :func:`viz.recording.write_overlay_recording`; ``None``: there is no recording.
            Without ``frames``, the pictures are white.
        meta: what is shown, in words.
    """

    run: Path
    figure: Mapping[str, Any]
    arrays: Mapping[str, Any] | None
    meta: Mapping[str, str]

    def draw(self) -> None:
        """Write both into the run folder."""
        from vidphys.data.frames import blank
        from viz.diagnosis import diagnosis_figure
        from viz.figures import save_svg
        from viz.recording import write_overlay_recording

        save_svg(diagnosis_figure(**self.figure), self.run / "figures" / "diagnosis.svg")
        if self.arrays is not None:
            white = {"frames": blank(len(self.arrays["frame_times"]))}
            path = self.run / "recordings" / "diagnosis.rrd"
            write_overlay_recording({**white, **self.arrays}, self.meta, path)


def drawing_of(run: Path, name: str, found: Answered, frames: Frames | None) -> Drawing:
    """What is drawn of an answer.

    Args:
        run: the run folder.
        name: of the recording.
        found: the answer.
        frames: of the clip, where it was one.
    """
    units, wall = found.told_in, found.data.get("wall")
    behind = frames if units.plane is None else None  # a picture lies in no other plane
    figure = {
        "times": found.times,
        "positions": units.per * found.positions,
        "rolled": {name: (when, units.per * path) for name, (when, path) in found.rolled.items()},
        "path": None if found.path is None else (found.path[0], units.per * found.path[1]),
        "said": found.headline,
        "unit": units.name,
        "picture": None if behind is None else (behind[len(behind) // 2], units.per),
        "probability": found.probability,
        "wall": None if wall is None else {**wall, "place": units.per * wall["place"]},
        "holds": found.data["terms"] if found.data["explained"] else (),
    }
    meta = {"cell": "diagnosis", "clip": name, **({"law": found.law} if found.law else {})}
    if found.stays:
        meta["foretold"] = STAYS
    return Drawing(run, figure, found.showcase(frames), meta)


class Drawer:
    """A process that draws once, as a context; it ends with it, and with its parent.

    Args:
        aside: whether to start it; else, and where the libraries are loaded here, this one draws.
    """

    def __init__(self, aside: bool) -> None:
        self.process: subprocess.Popen[bytes] | None = None
        if aside and sys.executable and not all(name in sys.modules for name in LIBRARIES):
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", START, *sys.path],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=True,  # an interrupt at the terminal is for its parent
            )
        self.sender = ThreadPoolExecutor(1)

    def __enter__(self) -> Drawer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait()
        self.sender.shutdown()

    def begin(self, make: Callable[[], Drawing]) -> Callable[[], Drawing]:
        """Have a drawing drawn; what is given waits for it, and raises what went wrong.

        Without a process of its own, it is drawn only then.
        """
        if self.process is not None:
            return self.sender.submit(_drawn_by, self.process, make).result

        def finish() -> Drawing:
            drawing = make()
            drawing.draw()
            return drawing

        return finish


def _drawn_by(process: subprocess.Popen[bytes], make: Callable[[], Drawing]) -> Drawing:
    """Hand it over, and wait for the answer."""
    drawing = make()
    answer, _ = process.communicate(pickle.dumps(drawing))
    if process.returncode:
        raise RuntimeError(f"the process that draws ended with {process.returncode}")
    error = pickle.loads(answer)
    if error is not None:
        raise error
    return drawing


def serve() -> None:
    """The inside of that process: load the libraries, draw what comes in, say how it went."""
    end_with_parent()
    answer = os.dup(1)
    os.dup2(2, 1)  # what a library prints is no answer
    import matplotlib.backends.backend_svg
    import matplotlib.figure  # noqa: F401
    import pyarrow
    import rerun  # noqa: F401

    import viz.diagnosis
    import viz.figures
    import viz.recording  # noqa: F401

    pyarrow.array([0.0])  # the first one loads pandas, where that is there
    sent = sys.stdin.buffer.read()
    if not sent:  # nothing is to be drawn after all
        return
    error: Exception | None = None
    try:
        pickle.loads(sent).draw()
    except Exception as raised:
        error = raised
    try:
        said = pickle.dumps(error)
        pickle.loads(said)
    except Exception:  # it cannot be sent: its text can
        said = pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))
    with os.fdopen(answer, "wb") as out:
        out.write(said)
