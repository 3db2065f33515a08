"""``vidphys play``: change a law, a start or a step under one's hand, and see it rolled at once."""

from __future__ import annotations

import gc
import sys
import webbrowser
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from vidphys.errors import InputError

if TYPE_CHECKING:
    from vidphys.play import Source, Stage
    from viz.played import Answering, Part

OPEN, ROLL, SURVEY, RECORD = KINDS = ("open", "roll", "survey", "record")
SWITCH = 1e-4  # seconds after which a thread that computes lets one that answers come in


@dataclass(frozen=True)
class PlayConfig:
    """Change a law, a start or a step on a page, and see it rolled at once.

    Example: vidphys play runs/ladder-quick

    Example: vidphys play runs/ladder-quick --episodes 10000

    The page lies on this machine alone. It shows the model beside the truth and its twin, 64
    episodes over 2,000 steps, with what went wrong, and a table of all episodes. An episode can be
    saved as a recording for `vidphys view`. Ctrl-C ends it.

    Args:
        run: folder of a ladder, a fit, a diagnosis or a training, or the name of a scene.
        input: what is rolled on from its last frame: a clip, for a training; a table, for a
            diagnosis of one, which keeps no copy.
        episodes: of a ladder or a scene, how many starts there are, 64 by default; the worst, the
            typical and the odd one are found among all of them.
        port: where the page is served; 0 takes any that is free.
        open: show the page in a browser; its address is printed all the same.
        weights: file or folder of the encoder's weights of a training; else VIDPHYS_WEIGHTS.
    """

    run: Annotated[str, tyro.conf.Positional]
    input: Annotated[Path | None, tyro.conf.Positional] = None
    episodes: int | None = None
    port: int = 0
    open: bool = True
    weights: Path | None = None


def play(config: PlayConfig) -> None:
    """See :class:`PlayConfig`.

    Raises:
        InputError: nothing there can be rolled, or the port is taken.
    """
    from loops.threads import held_to
    from vidphys.play import source_of
    from vidphys.play.asked import MOST_EPISODES
    from viz.played import play_page

    if not 0 <= config.port < 2**16:
        raise InputError(f"--port {config.port}: must be from 0 to 65535")
    if config.episodes is not None and not 1 <= config.episodes <= MOST_EPISODES:
        raise InputError(f"--episodes {config.episodes}: must be from 1 to {MOST_EPISODES}")
    source = source_of(config.run, config.input, config.weights, config.episodes)
    told = {"title": "Play", "folder": Path(config.run).resolve().name, "cells": source.names}
    with ExitStack() as stack:
        try:
            address, desk = stack.enter_context(play_page(told, config.port, KINDS))
        except OSError as error:
            raise InputError(f"--port {config.port}: cannot be used ({error.strerror})") from error
        print(f"open      {address}")
        print("Ctrl-C ends it", flush=True)
        if config.open:
            webbrowser.open(address)
        sys.setswitchinterval(SWITCH)
        stack.enter_context(held_to(1))  # operations here are small: threads would wait for another
        player = Player(source)
        player.prepare(source.names[0])
        gc.freeze()  # to look through all that was loaded takes as long as two changes
        desk.work(player.answers)


class Player:
    """Answers the page's questions, each stage made once."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.stages: dict[str, Stage] = {}
        self.surveyed: tuple[str, list[dict[str, Any]]] = ("", [])  # the last, under its law
        self.answers: dict[str, Answering] = {
            OPEN: self.opened,
            ROLL: self.rolled,
            SURVEY: self.survey,
            RECORD: self.record,
        }

    def prepare(self, name: str) -> None:
        """Make a stage and compile its law while the browser still opens."""
        from vidphys.play import Asked

        with suppress(ValueError, RuntimeError):  # the page says it, when it asks
            next(self.rolled(Asked(cell=name, steps=1).model_dump_json().encode()))

    def opened(self, body: bytes) -> Iterator[Part]:
        """What there is to move on a stage; the body is its name."""
        yield self._stage(body.decode(errors="replace")).told(), None

    def rolled(self, body: bytes) -> Iterator[Part | float]:
        """A change, rolled."""
        from vidphys.play import Asked, answers

        asked = Asked.read(body)
        for piece in answers(self._stage(asked.cell), asked):
            if piece is None or piece.about["role"] == "pause":
                yield piece.about["seconds"] if piece else 0.0
                continue
            places = piece.places
            shape = None if places is None else list(places.shape)
            numbers = None if places is None else places.float().numpy()
            yield {**piece.about, "shape": shape}, numbers

    def survey(self, body: bytes) -> Iterator[Part]:
        """What became of every episode; kept until another law is asked."""
        from vidphys.play import Asked, survey

        asked = Asked.read(body)
        law = asked.model_dump_json(exclude={"episode", "q", "v"})
        if self.surveyed[0] != law:
            found = []
            for piece in survey(self._stage(asked.cell), asked):
                if piece.about["role"] == "table":
                    found.append(piece.about)
                yield piece.about, None
            self.surveyed = law, found
        else:
            for about in self.surveyed[1]:
                yield about, None

    def record(self, body: bytes) -> Iterator[Part]:
        """The episode that is looked at, as the bytes of a recording."""
        from vidphys.cli.played import write_played
        from vidphys.play import Asked

        asked = Asked.read(body)
        with TemporaryDirectory() as folder:
            path = Path(folder) / "played.rrd"
            write_played(self._stage(asked.cell), asked, path)
            recording = path.read_bytes()
        name = f"{asked.cell.replace('/', '-').replace(', ', '-')}-{asked.episode}.rrd"
        yield {"role": "recording", "name": name.replace(" ", "")}, recording

    def _stage(self, name: str) -> Stage:
        if name not in self.stages:
            self.stages[name] = self.source.stage(name)
        return self.stages[name]
