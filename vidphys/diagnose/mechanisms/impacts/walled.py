"""A law beside walls, where impacts tell of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from vidphys.diagnose.mechanisms.fitted import Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.impacts.kinks import Struck, seen_as, walls_of
from vidphys.diagnose.mechanisms.starts.guesses import Guess
from vidphys.diagnose.mechanisms.terms import Wall

MOST = 2  # walls


def walled(clips: Sequence[Frames], guess: Guess) -> Iterator[Guess]:
    """The same law beside the walls that the longest clip's impacts tell of, if there are any."""
    model, number = guess.model, int(np.argmax([len(c.times) for c in clips]))
    clip = clips[number]
    s = guess.read(clip.stretches[0].places)
    struck = walls_of(seen_as(clip.impacts, clip.stretches[0].times, s), s)[:MOST]
    if not struck:
        return
    law = replace(model.law, walls=tuple(map(_wall, struck)))
    at = len(model.law.names)
    told = np.concatenate([_numbers(w) for w in struck])
    values = [np.concatenate([x[:at], told, x[at:]]) for x in guess.values]
    yield Guess(Model(law, model.charts), values, guess.read)


def _wall(struck: Struck) -> Wall:
    return Wall(tuple(struck.normal.tolist()), len(struck.normal) == 2 and struck.count > 1)


def _numbers(struck: Struck) -> list[float]:
    """In the order of :attr:`vidphys.diagnose.mechanisms.law.Law.names`."""
    along = [struck.along] if len(struck.normal) > 1 else []
    return [struck.place, struck.restitution, *along, *([0.0] if _wall(struck).turns else [])]
