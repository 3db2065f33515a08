"""What the page asks: which model, from where, under which law, by which steps."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, ValidationError

from vidphys.boundary import Above, Closed, Number, Word, said
from vidphys.errors import InputError

MOST_STEPS, MOST_EPISODES = 20_000, 100_000
Places = Annotated[
    list[Annotated[list[Number], Field(min_length=1, max_length=3)]], Field(max_length=1000)
]


class Asked(Closed):
    """One change, as JSON.

    Args:
        cell: name of the stage.
        episode: that is looked at; its start is the one that ``q`` and ``v`` change.
        coupling: of all episodes; each its own where it is ``None``.
        factors: on numbers of the law, see :meth:`vidphys.reading.laws.Law.changed`.
        q: places of the bodies at the start, as they are drawn.
        v: their velocities there, per second.
        integrator: by name; the model's own where it is ``None``.
        dt: seconds of a step; the model's own where it is ``None``.
        steps: to roll.
    """

    cell: Word
    episode: Annotated[int, Field(ge=0, lt=MOST_EPISODES)] = 0
    coupling: Number | None = None
    factors: Annotated[dict[Word, Number], Field(max_length=50)] = {}
    q: Places | None = None
    v: Places | None = None
    integrator: Word | None = None
    dt: Above | None = None
    steps: Annotated[int, Field(ge=1, le=MOST_STEPS)] = 2000

    @classmethod
    def read(cls, body: bytes) -> Asked:
        """From the body of a request.

        Raises:
            InputError: it is something else; the first field that is wrong is named.
        """
        try:
            return cls.model_validate_json(body)
        except ValidationError as error:
            raise InputError(f"play: {said(error)}") from error
