"""Many clips through one frozen encoder: windows of several clips fill a pass.

A pass costs the same whether its windows are of one clip or of several, and a window's features do
not depend on its company, so that short clips cost what long ones do. Frames are taken as they
come, and no more windows wait than one pass has, of each shape of frames. While a card computes a
pass, the features of the one before it are written and the frames of the next are read.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor

from encoders.entry import Entries
from encoders.frozen.base import FrozenEncoder
from encoders.frozen.transfers import Coming
from encoders.frozen.windows import Window, feature_times, seen_by, windows

MOST_OPEN = 32  # clips whose last windows wait for company


@dataclass(frozen=True)
class ComingClip:
    """A clip of which features are wanted.

    Args:
        chunks: gives its frames, bytes ``(n, c, H, W)``, in order; called once for all layers that
            see the same pixels.
        times: seconds of each frame.
        layers: that are wanted.
        begin: opens what layers with the same feature frames are written to; see
            :meth:`encoders.FeatureStore.begin`.
        done: called once all is written.
    """

    chunks: Callable[[], Iterable[Tensor]]
    times: Float[Tensor, " t"]
    layers: Sequence[str]
    begin: Callable[[tuple[str, ...], Tensor], Entries]
    done: Callable[[], None] = lambda: None


@dataclass
class _Part:
    """Layers of a clip that are read together, and how many of its windows are still to come."""

    entries: Entries
    left: int
    clip: _Open


@dataclass
class _Open:
    """A clip whose features are not all there."""

    done: Callable[[], None]
    parts: list[_Part] = field(default_factory=list)
    taken: bool = False  # all of its windows came


Waiting = list[tuple[Tensor, Window, _Part]]


class ManyClips:
    """Encodes clips as they come; :attr:`busy` seconds of the time were spent in the network.

    Args:
        encoder: whose layers are read.
        passed: called with the windows done after each pass.
    """

    def __init__(
        self, encoder: FrozenEncoder, passed: Callable[[int], None] = lambda windows: None
    ) -> None:
        self.encoder, self.passed, self.busy = encoder, passed, 0.0
        self._waiting: dict[Hashable, Waiting] = {}
        self._open: list[_Open] = []
        self._under_way: tuple[Coming, Waiting] | None = None

    def encode(self, clips: Iterable[ComingClip]) -> None:
        """Encode all clips; after an error those before it are whole, and of others nothing is.

        Raises:
            ValueError: see :meth:`encoders.frozen.base.FrozenEncoder.stream`.
        """
        try:
            for clip in clips:
                self._take(clip)
                if len(self._open) >= MOST_OPEN:
                    self._flush()
            self._flush()
        except BaseException as error:
            with suppress(Exception):  # the first error is the one that is told
                self._finish()
            for opened in [each for each in self._open if not each.taken]:
                self._abandon(opened, error)
            if isinstance(error, Exception):
                with suppress(Exception):
                    self._flush()
            for opened in list(self._open):
                self._abandon(opened, error)
            raise

    def _abandon(self, opened: _Open, error: BaseException) -> None:
        """Leave nothing of a clip."""
        self._open.remove(opened)
        for part in opened.parts:
            part.entries.__exit__(type(error), error, error.__traceback__)
        for key, waiting in list(self._waiting.items()):
            kept = [job for job in waiting if job[2].clip is not opened]
            self._waiting[key] = kept
            if not kept:
                del self._waiting[key]

    def _take(self, clip: ComingClip) -> None:
        """Let a clip's windows wait for passes, which are run as they fill."""
        encoder, opened = self.encoder, _Open(clip.done)
        taken = clip.times[:: encoder.frame_stride]
        self._open.append(opened)
        planned = []
        for seer, layers in encoder.groups(clip.layers):
            plan = windows(len(taken), seer.windowing)
            entries = clip.begin(layers, feature_times(taken, seer.windowing))
            part = _Part(entries, len(plan), opened)
            opened.parts.append(part)
            planned.append((seer, layers, plan, part))
        for seer, layers, plan, part in planned:
            for seen, window in self._jobs(clip, plan):
                key = layers, tuple(seen.shape)
                waiting = self._waiting.setdefault(key, [])
                waiting.append((seen, window, part))
                if len(waiting) == encoder.batch:
                    self._run(seer, layers, self._waiting.pop(key))
        opened.taken = True

    def _jobs(self, clip: ComingClip, plan: list[Window]) -> Iterator[tuple[Tensor, Window]]:
        return zip(seen_by(plan, clip.chunks(), self.encoder.frame_stride), plan, strict=True)

    def _flush(self) -> None:
        """Run the passes that are not full."""
        for key in list(self._waiting):
            layers: tuple[str, ...] = key[0]  # type: ignore[index]
            self._run(self.encoder.at(layers[0]), layers, self._waiting.pop(key))
        self._finish()

    def _run(self, seer: FrozenEncoder, layers: tuple[str, ...], jobs: Waiting) -> None:
        """Begin a pass; the one before it is finished meanwhile."""
        windows = [(seen, window) for seen, window, _ in jobs]
        with torch.inference_mode():
            coming = Coming(lambda: seer.one_pass(windows, layers), seer.device)
        self._finish()
        self._under_way = coming, jobs
        if not coming.under_way:
            self._finish()

    def _finish(self) -> None:
        """Write what the pass that is under way gives."""
        if self._under_way is None:
            return
        (coming, jobs), self._under_way = self._under_way, None
        found = coming.maps()
        self.busy += coming.seconds
        for number, (_, _, part) in enumerate(jobs):
            part.entries.add([maps[number] for maps in found])
            part.left -= 1
            if not part.left:
                part.entries.__exit__(None, None, None)
                part.clip.parts.remove(part)
                if not part.clip.parts:
                    self._open.remove(part.clip)
                    part.clip.done()
        self.passed(len(jobs))
