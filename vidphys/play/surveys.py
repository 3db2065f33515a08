"""All episodes of a stage under one law: what became of each, without their ways."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from vidphys.play.asked import Asked
from vidphys.play.rolling import Kept, Piece, begun, of_model, of_truth
from vidphys.play.rows import table
from vidphys.play.stage import Stage

BATCH = 1024  # episodes at a time: more cost little more, and a change waits for one piece of them


def survey(stage: Stage, asked: Asked) -> Iterator[Piece]:
    """Rows of all episodes from where each began, a batch at a time.

    Args:
        stage: with a scene, which has the truth.
        asked: the law and the steps; a start that was moved is left where it was.

    Yields:
        ``survey`` with the episodes so far, so that a change need not wait for a batch; ``table``
        with ``first`` and the columns of a batch, with the stored states at which each left its
        valid range or was not finite (-1: never).

    Raises:
        InputError: something that this model cannot be asked.
    """
    calm = asked.model_copy(update={"episode": 0, "q": None, "v": None})
    for first in range(0, stage.episodes, BATCH):
        part = replace(stage.some(first, BATCH), twin=None)
        start, law, how = begun(part, calm)
        how = how._replace(once=False)
        model, truth, count = Kept(), Kept(), part.episodes
        happened = {"left": [-1] * count, "bad": [-1] * count}
        for piece in of_model(part, law, start, how, calm, model):
            if piece is not None:
                happened = {key: _first(happened[key], piece.about, key) for key in happened}
            yield Piece({"role": "survey", "done": first})
        for _ in of_truth(part, calm, start, law.params, how, truth):
            yield Piece({"role": "survey", "done": first})
        rows = table(part, law.params, model.whole, truth.whole) | happened
        yield Piece({"role": "table", "episode": first, "every": how.every, "rows": rows})


def _first(seen: list[int], about: dict[str, Any], name: str) -> list[int]:
    """When it happened first, as it is known after another piece."""
    new = [x + about["first"] * (x >= 0) for x in about[name]]
    return [x if x >= 0 else y for x, y in zip(seen, new, strict=True)]
