"""The program that reads clips from an HDF5 file, a group each.

``clips`` sends what each holds beside its frames, a message a clip; ``frames`` sends the frames of
one, a message before some of them.
"""

from __future__ import annotations

import contextlib
import sys
from typing import Any

import h5py
import numpy as np
from confined import FILE, RefusedError, allow, confine, refusing, require_room, say, send, write

BLOCK = 2**25  # bytes of frames that are read at once, where they are stored together
WORDS = 300  # characters of a word that are kept


def main(what: str, memory: int, seconds: int, *more: str) -> None:
    """Read the file.

    Args:
        what: is read: ``clips`` or ``frames``.
        memory: bytes that may be asked for, on top of those of the libraries.
        seconds: of processor time, for what is sent in one message.
        more: see :class:`Clips`, or the path of the frames in the file.
    """
    confine(memory)
    allow(seconds)
    with refusing("an HDF5 file", memory), h5py.File(FILE, "r") as file:
        if what == "clips":
            most_bytes, most_members, *names = more
            Clips(int(most_bytes), int(most_members), names).send(file, seconds)
        else:
            frames(file[more[0]], seconds)


class Clips:
    """What groups hold.

    Args:
        most_bytes: of numbers of a clip.
        most_members: of a group.
        names: that frames may have.
    """

    def __init__(self, most_bytes: int, most_members: int, names: list[str]) -> None:
        self.most_bytes, self.most_members, self.names = most_bytes, most_members, names

    def send(self, file: h5py.File, seconds: int) -> None:
        """Send how many clips there are, then each."""
        groups = [("0", file)] if self.frames(file) is not None else []
        own = self.own(file)
        groups += [(name, x) for name, x in own.items() if isinstance(x, h5py.Group)]
        clips = [(name, x) for name, x in groups if self.frames(x) is not None]
        say({"count": len(clips)})
        for name, group in clips:
            allow(seconds)
            self.send_clip(name, group)

    def own(self, group: h5py.Group) -> dict[str, Any]:
        """What it holds itself, without what its links lead to, in other files or elsewhere."""
        if len(group) > self.most_members:
            raise RefusedError(f"{len(group)} members of a group, more than {self.most_members}")
        return {name: group[name] for name in group if is_own(group, name)}

    def frames(self, group: h5py.Group) -> h5py.Dataset | None:
        """The frames of a group, if it has some."""
        held = self.own(group)
        found = next((held[name] for name in self.names if name in held), None)
        return in_here(found) if isinstance(found, h5py.Dataset) else None

    def send_clip(self, name: str, group: h5py.Group) -> None:
        """Send what it holds beside its frames."""
        shown = self.frames(group)
        assert shown is not None
        arrays, facts = {}, {k: plain(x) for k, x in group.attrs.items() if not np.ndim(x)}
        for key, held in self.own(group).items():
            if key in self.names or not isinstance(held, h5py.Dataset) or held.shape is None:
                continue
            kind = in_here(held).dtype.kind
            if not held.shape and kind in "fiubO":
                facts[key] = plain(held[()])
            elif kind in "fiub":
                require_room(held.shape, self.most_bytes, held.name)
                arrays[key] = held[()]
        facts = {key: x for key, x in facts.items() if isinstance(x, str | int | float | bool)}
        about = {"frames": shown.name, "shape": shown.shape, "dtype": shown.dtype.str}
        send(arrays, name=name, facts=facts, **about)


def is_own(group: h5py.Group, name: str) -> bool:
    """Whether a group holds something by a name, and no link leads elsewhere."""
    return isinstance(group.get(name, getlink=True), h5py.HardLink)


def in_here(held: h5py.Dataset) -> h5py.Dataset:
    """The same, whose numbers lie in this file.

    Raises:
        RefusedError: they lie in another one.
    """
    if held.external or held.is_virtual:
        raise RefusedError(f"{held.name} lies in another file; copy it into this one")
    return held


def plain(value: Any) -> Any:
    """A single number or word as Python's."""
    value = value.item() if isinstance(value, np.generic) else value
    value = value.decode(errors="replace") if isinstance(value, bytes) else value
    return value[:WORDS] if isinstance(value, str) else value


def frames(held: h5py.Dataset, seconds: int) -> None:
    """Send all frames, as many at once as are stored together."""
    in_here(held)
    together = held.chunks[0] if held.chunks else 1
    each = max(1, min(together, BLOCK // int(np.prod(held.shape[1:]))))
    for first in range(0, len(held), each):
        allow(seconds)
        block = held[first : first + each]
        say({"count": len(block)})
        write(np.ascontiguousarray(block).view(np.uint8))


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError, KeyboardInterrupt):
        what, memory, seconds, *more = sys.argv[1:]
        main(what, int(memory), int(seconds), *more)
