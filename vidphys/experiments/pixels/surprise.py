"""Is a model surprised where a clip breaks its law, and only there?

A model that has read a state from a few frames foretells the next ones. Its *surprise* is how far
what it then sees is from that (violation of expectation; Garrido et al., "Intuitive physics
understanding emerges from self-supervised pretraining on natural videos", 2025, who take the
largest over windows of a clip, as here).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import torch
from torch import Generator, Tensor

from binders import Tracks
from dynamics import Head, Parameters, ballistic
from vidphys import metrics
from vidphys.data.clips import render_clips
from vidphys.experiments.core.cell import CellTask, Table
from vidphys.experiments.pixels.broken import (
    ANYWHERE,
    AT_A_STRIKE,
    LAWFUL,
    Breaks,
    Broken,
    broken,
)
from vidphys.experiments.pixels.pixel_cell import TWINS, PixelCell, Scored
from vidphys.experiments.pixels.seen import Perceived, pixel_scene
from vidphys.perception.catalogue import RUNGS
from vidphys.progress import Progress
from vidphys.runs.records import Recorder
from vidphys.scenes.strikes import strikes
from vidphys.seeding import derive
from vidphys.shooting.foretold import missed
from vidphys.shooting.initial_state import choose_slack

RUNGS_ASKED = ("renderer", "cnn-supervised", "dino-tiny", "hiera")
CONTEXTS = (4, 7, 12)  # frames that a state is read from
AHEAD = 4  # frames that are foretold from it
STRAIGHT = "ballistic"  # the predictor without any force, beside the heads
WINDOWS = 3  # one after the other, the first after the longest context


@dataclass(frozen=True)
class SurpriseCell(PixelCell):
    """Heads trained on a rung's tracks, asked which of two clips breaks the law.

    Args:
        breaks: where and how clips are broken.
    """

    breaks: Breaks = ANYWHERE

    def also(
        self, task: CellTask, seed: int, head: str, scored: Sequence[Scored], perceived: Perceived
    ) -> None:
        g, asked = self.grounding, partial(_watched, task, perceived, seed, self.breaks)
        watched = task.kept.once("watched", (g.name, seed), asked)
        progress = task.stage("surprise")
        for one in scored:
            score_surprise(one.recorder, one.head, perceived, watched, progress)
        if head == self.heads[0]:
            scene = perceived.seen.asked.scene
            floor = task.recorder(seed, scene, STRAIGHT, STRAIGHT, g.name, g.encoder, g.binder)
            score_surprise(floor.reading("shooting"), ballistic(), perceived, watched)


@dataclass(frozen=True)
class Watched:
    """What a perception sees in broken clips and in their lawful twins.

    Args:
        tracks: of each kind, of the same episodes.
        params: the law that held before.
    """

    tracks: dict[str, Tracks]
    params: Parameters


def _watched(task: CellTask, perceived: Perceived, seed: int, breaks: Breaks) -> Watched:
    asked, train = perceived.seen.asked, perceived.seen.train
    sizes, frames = task.pixel, CONTEXTS[-1] + WINDOWS * AHEAD
    name, few = "surprise", sizes.held_out
    clips = render_clips(asked.scene, train.world, few, frames, sizes.stride, seed, name)
    rng = Generator().manual_seed(derive(seed, "breaks"))
    made = broken(asked.scene, clips, sizes.stride, CONTEXTS[-1] + 1, rng, breaks)
    return Watched(_seen(perceived, made), made.clips[LAWFUL].params)


def _seen(perceived: Perceived, made: Broken) -> dict[str, Tracks]:
    return {name: perceived.perception.tracks(clips) for name, clips in made.clips.items()}


def score_surprise(
    recorder: Recorder,
    head: Head,
    perceived: Perceived,
    watched: Watched,
    progress: Progress | None = None,
) -> None:
    """Of each way to break the law and each context: how surely surprise tells it.

    ``surprise_auroc`` is over all clips; ``surprise_pairs`` is the share of broken clips that
    surprise more than their own lawful twin. Of all ways together they stand in ``..._all``.

    Args:
        recorder: gets the numbers; ``horizon`` is the context in frames.
        head: trained on the tracks of ``perceived``.
        perceived: its training clips say how far the head is trusted.
        watched: tracks of the clips.
        progress: called for each context and kind of clip.
    """
    train = perceived.seen.train
    slack = choose_slack(head, perceived.train, train.params, train.interval)
    asked = len(CONTEXTS) * len(watched.tracks)
    for place, context in enumerate(CONTEXTS):
        found: dict[str, Tensor] = {}
        for name, tracks in watched.tracks.items():
            found[name] = surprise(head, tracks, watched.params, train.interval, context, slack)
            if progress:
                progress(place * len(watched.tracks) + len(found), asked, 0.0)
        lawful = found.pop(LAWFUL)
        twice = lawful.repeat(len(found))
        for name, values in {**found, "all": torch.cat([*found.values()])}.items():
            twin = twice if name == "all" else lawful
            recorder.add(f"surprise_auroc_{name}", metrics.auroc(values, lawful), None, context)
            recorder.add(f"surprise_pairs_{name}", metrics.above(values, twin), None, context)
            recorder.add_episodes(f"surprise_{name}", values, None, context)
        recorder.add("surprise_lawful", metrics.median(lawful), None, context)
        recorder.add_episodes("surprise_lawful", lawful, None, context)


def surprise(
    head: Head, tracks: Tracks, params: Parameters, interval: float, context: int, slack: float
) -> Tensor:
    """The largest mean distance between what is foretold and what is seen, ``(b,)``, world units.

    Args:
        head: trained.
        tracks: of whole clips, ``(b, t, n, 2)``; what is not finite is far from anything.
        params: of each clip.
        interval: seconds between frames.
        context: frames before each window, from which its start is read.
        slack: see :func:`vidphys.shooting.initial_state.choose_slack`.
    """
    frames = tracks.positions.shape[1]
    ends = range(CONTEXTS[-1], frames - AHEAD + 1, AHEAD)
    found = []
    for end in ends:
        window = slice(end - context, end + AHEAD)
        seen = Tracks(
            tracks.positions[:, window], tracks.confidence[:, window], tracks.times[window]
        )
        found.append(missed(head, seen, params, interval, AHEAD, slack))
    return torch.stack(found).amax(0)


STRIKES = "{}@strikes"  # a rung that is asked where bodies strike each other

SURPRISE = Table.told(
    "surprise",
    cells={
        **{name: SurpriseCell(RUNGS[name], TWINS) for name in RUNGS_ASKED},
        **{
            STRIKES.format(name): SurpriseCell(RUNGS[name], TWINS, strikes, breaks=AT_A_STRIKE)
            for name in RUNGS_ASKED
        },
    },
    settings={
        "scene": pixel_scene().settings,
        "breaks": sorted(ANYWHERE.ways),
        "strikes": strikes().settings,
        "breaks_at_a_strike": sorted(AT_A_STRIKE.ways),
        "contexts": CONTEXTS,
        "ahead": AHEAD,
    },
)
