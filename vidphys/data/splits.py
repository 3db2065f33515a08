"""What is trained on, what ends the training, and what is scored: whole clips, or parts of each.

Of several clips, the first are trained on, one in five of those decides when to stop, and the
others are scored; clips that belong together stay together, and a data set may say which is which
itself. A clip that is cut in time has its first part trained on, every fifth block of that decides,
and what comes after is scored. No clip is in two of them, whatever its name is.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from vidphys.data.clip_files import ClipFile
from vidphys.errors import InputError

AUTO, CLIP, TIME = "auto", "clip", "time"  # what clips are split by; else by one of their facts
EPISODE = "episode_index"
BLOCK = 8  # frames
EVERY = 5  # one block, or clip, in so many
Role = Literal["train", "held_out", "scored"]
SPLITS: dict[str, Role] = {
    **dict.fromkeys(("train", "training"), "train"),
    **dict.fromkeys(("val", "valid", "validation", "dev", "held_out"), "held_out"),
    **dict.fromkeys(("test", "testing", "eval", "scored"), "scored"),
}
SAID = {"train": "what is trained on", "held_out": "what is held out", "scored": "what is scored"}


@dataclass(frozen=True)
class Split:
    """Of each clip in turn.

    Args:
        train, held_out, scored: numbers of its feature frames; empty ones for most clips.
        known: its frames, from the start, that heads may be fitted to; 0 for a scored clip.
        asked: its first frame that is foretold and scored; ``None`` where it is not.
        each: frames that a feature frame stands for.
    """

    train: tuple[Tensor, ...]
    held_out: tuple[Tensor, ...]
    scored: tuple[Tensor, ...]
    known: tuple[int, ...]
    asked: tuple[int | None, ...]
    each: int


def split_frames(frames: int, features: int, each: int, share: float) -> Split:
    """One clip, cut in time.

    Args:
        frames, features: of the clip, and of its features.
        each: frames that a feature frame stands for.
        share: of the clip, from its start, that is trained on.

    Raises:
        InputError: the share leaves nothing to train on or to score.
    """
    block = max(1, BLOCK // each)
    end = round(features * share)
    if not block * EVERY <= end < features:
        raise InputError(
            f"train share {share}: leaves {end * each} of {frames} frames to train on and "
            f"{max(0, frames - end * each)} to score; needs at least {block * EVERY * each} and "
            f"{each}"
        )
    number = torch.arange(end)
    held = (number // block) % EVERY == EVERY // 2
    scored = torch.arange(end, features)
    return Split((number[~held],), (number[held],), (scored,), (end * each,), (end * each,), each)


def split_times(frames: Sequence[int], features: Sequence[int], each: int, share: float) -> Split:
    """Every clip cut in time; see :func:`split_frames`."""
    own = [split_frames(*counts, each, share) for counts in zip(frames, features, strict=True)]
    return Split(
        tuple(part.train[0] for part in own),
        tuple(part.held_out[0] for part in own),
        tuple(part.scored[0] for part in own),
        tuple(part.known[0] for part in own),
        tuple(part.asked[0] for part in own),
        each,
    )


def split_clips(
    frames: Sequence[int], features: Sequence[int], each: int, roles: Sequence[Role]
) -> Split:
    """Several clips; the second half of each scored one is foretold from its first.

    Args:
        frames, features: of each clip, and of its features.
        each: frames that a feature frame stands for.
        roles: of each clip.
    """
    train, held_out, scored, known, asked = [], [], [], [], []
    none = torch.arange(0)
    for role, whole, cells in zip(roles, frames, features, strict=True):
        every = torch.arange(cells)
        train.append(every if role == "train" else none)
        held_out.append(every if role == "held_out" else none)
        scored.append(every if role == "scored" else none)
        known.append(0 if role == "scored" else whole)
        asked.append(whole - whole // 2 if role == "scored" else None)
    return Split(tuple(train), tuple(held_out), tuple(scored), tuple(known), tuple(asked), each)


def roles_by_group(groups: Sequence[Hashable], share: float) -> list[Role]:
    """The role of each clip; those of one group have the same.

    Args:
        groups: of each clip; a number of its own where it stands alone.
        share: of the groups that is trained on, at least two; at least one is scored.

    Raises:
        InputError: too few groups for that.
    """
    order = list(dict.fromkeys(groups))
    count, what = len(order), "clips" if len(order) == len(groups) else "groups of clips"
    end = round(count * share)
    if not 2 <= end < count:
        raise InputError(
            f"train share {share}: leaves {end} of {count} {what} to train on and {count - end} to "
            "score; needs at least two (one of them to stop by) and one"
        )
    held = _held(end)
    roles: list[Role] = ["held_out" if k in held else "train" for k in range(end)]
    own = dict(zip(order, roles + ["scored"] * (count - end), strict=True))
    return [own[group] for group in groups]


def roles_by_name(names: Sequence[str], groups: Sequence[Hashable]) -> list[Role] | None:
    """The role of each clip as its data set says it; ``None`` where that leaves none to score.

    Args:
        names: of the splits: train, val and test, or what they are usually called.
        groups: of each clip; where nothing is held out, one in five of train's groups is.

    Raises:
        InputError: a name that is not known, or only one group to train on.
    """
    unknown = next((name for name in names if name.lower() not in SPLITS), None)
    roles = [SPLITS.get(name.lower(), "train") for name in names]
    if set(roles) <= {"train"}:
        return None
    if unknown is not None:
        which = f"split {unknown!a}" if unknown else "a clip in no split"
        raise InputError(
            f"{which}: a data set has train, val and test, and each clip in one of them; "
            "`split_by` clip, time or a fact of its clips"
        )
    if "scored" not in roles:  # what there is beside train is scored
        roles = ["scored" if role == "held_out" else role for role in roles]
    if "held_out" not in roles:
        own = list(
            dict.fromkeys(g for g, role in zip(groups, roles, strict=True) if role == "train")
        )
        if len(own) < 2:
            raise InputError("split train: needs at least two clips, one of them to stop by")
        held = {own[k] for k in _held(len(own))}
        pairs = zip(groups, roles, strict=True)
        roles = ["held_out" if r == "train" and g in held else r for g, r in pairs]
    if "train" not in roles:
        raise InputError("its splits leave no clip to train on")
    return roles


def groups_of(files: Sequence[ClipFile], by: str) -> list[Hashable]:
    """What each clip must stay together with; cameras that saw the same always do.

    Args:
        files: the clips.
        by: ``auto`` or ``clip``, a number of its own for each; or the name of a fact.

    Raises:
        InputError: a clip that has no such fact.
    """
    facts = [file.facts for file in files]
    if by in (AUTO, CLIP):
        several = len({each.get("camera") for each in facts}) > 1
        return [f.get(EPISODE, k) if several else k for k, f in enumerate(facts)]
    for file, each in zip(files, facts, strict=True):
        if by not in each:
            raise InputError(
                f"{file.path}: no fact {by!a} to split by; it has {', '.join(each) or 'none'}; or "
                f"use {AUTO} or {CLIP}"
            )
    return [each[by] for each in facts]


def _held(count: int) -> set[int]:
    return {k for k in range(count) if k % EVERY == EVERY // 2} or {count - 1}


def refuse_leaks(
    names: Sequence[str],
    hashes: Sequence[str],
    roles: Sequence[Hashable],
    said: Callable[[Any, Any], str] = lambda one, other: f"in {SAID[one]} and in {SAID[other]}",
) -> None:
    """Refuse a clip that is in two splits, perhaps under two names.

    Args:
        names, hashes, roles: of each clip, and of its content.
        said: where a clip would be that is in two of them, in words.

    Raises:
        InputError: there is one.
    """
    first: dict[str, int] = {}
    for k, (digest, role) in enumerate(zip(hashes, roles, strict=True)):
        before = first.setdefault(digest, k)
        if roles[before] != role:
            raise InputError(
                f"{names[before]} and {names[k]} are the same clip, and would be "
                f"{said(role, roles[before])}: remove one, or split by a fact that both share"
            )
