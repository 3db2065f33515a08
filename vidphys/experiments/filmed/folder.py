"""Filmed clips as a folder that anyone can tune on.

::

    OUT/run.json                   seed and versions; the same command goes on
    OUT/clips/00000/clip.mp4       H.264
    OUT/clips/00000/truth.json     see :class:`.truth.Truth`; written last
    OUT/index.json                 kind, part and structure of each clip
"""

from __future__ import annotations

from pathlib import Path

from vidphys.errors import InputError
from vidphys.experiments.filmed.encode import require_av, write_h264
from vidphys.experiments.filmed.film import clip_of, pictures, truth_of
from vidphys.experiments.filmed.truth import SCHEMA_VERSION, Truth
from vidphys.progress import Progress
from vidphys.runs.atomic import write_json, write_with

CLIPS, CLIP, TRUTH, INDEX = "clips", "clip.mp4", "truth.json", "index.json"
TOLD = ("kind", "part", "structure")


def film_clip(folder: Path, seed: int, number: int) -> Path:
    """Film a clip, unless it is there and whole; returns its own folder.

    Args:
        folder: gets ``clips/NUMBER``.
        seed, number: all that the clip depends on.

    Raises:
        InputError: PyAV is missing, or this machine cannot draw.
    """
    where = folder / CLIPS / f"{number:05d}"
    if (where / TRUTH).exists() and (where / CLIP).exists():
        return where
    require_av()
    clip = clip_of(seed, number)
    truth = truth_of(clip)
    frames = pictures(clip, truth)
    write_with(
        where / CLIP,
        lambda partial: write_h264(partial, frames, truth.stamps, clip.add.rate, clip.add.crf),
    )
    truth.write(where / TRUTH)
    return where


def film_folder(folder: Path, seed: int, clips: int, progress: Progress | None = None) -> Path:
    """Film what is not there yet, then write the index of all; returns the index's path.

    Args:
        folder: where.
        seed: of all clips.
        clips: how many, counted from the first; those beyond that lie there stay.
        progress: called as ``(clips done, clips, 0.0)``.

    Raises:
        InputError: no clip is asked for, PyAV is missing, or this machine cannot draw.
    """
    if clips < 1:
        raise InputError(f"`clips` {clips}: must be at least 1")
    for number in range(clips):
        film_clip(folder, seed, number)
        if progress is not None:
            progress(number + 1, clips, 0.0)
    entries = []
    for truth in sorted((folder / CLIPS).glob(f"*/{TRUTH}")):
        told = Truth.read(truth)
        about = {name: getattr(told, name) for name in TOLD}
        entries.append({"folder": f"{CLIPS}/{truth.parent.name}", **about})
    write_json(folder / INDEX, {"schema_version": SCHEMA_VERSION, "seed": seed, "clips": entries})
    return folder / INDEX
