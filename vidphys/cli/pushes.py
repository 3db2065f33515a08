"""What `vidphys rollout --reach` asks and says: a push that takes a body to a place."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, TypeVar

from vidphys.cli.options import refuse

if TYPE_CHECKING:
    from vidphys.cli.rollout import RolloutConfig
    from vidphys.reading.fitted import Rolled
    from vidphys.reading.forecasts import Forecast
    from vidphys.reading.steering import Aim, Push

    Rolls = TypeVar("Rolls", Forecast, Rolled)

OPTIONS = ("reach", "body", "most", "search")


def aim_of(config: RolloutConfig) -> Aim | None:
    """Where a body shall be, if that was asked.

    Raises:
        InputError: options of a push, but no place.
    """
    if not config.reach:
        refuse(config, OPTIONS[1:], "they are of a push; say where to with --reach")
        return None
    from vidphys.reading.steering import SLOPES, Aim

    body = 1 if config.body is None else config.body
    return Aim(config.reach, body - 1, config.most, config.search or SLOPES)


def named(held: Rolls, other: Rolls | None) -> Iterator[tuple[str, Rolls]]:
    """The rollouts that there are, each with what it is called."""
    yield "the law that held", held
    if other is not None:
        yield ("the changed law" if other.push is None else "with the push"), other


def told_push(push: Push | None) -> str:
    """What was found, in words that go on a line; nothing where nothing was looked for."""
    if push is None:
        return ""
    change = ", ".join(f"{x:.4g}" for x in push.change)
    return (
        f"; the push changes the body's velocity by ({change}) a second, and leaves it "
        f"{push.left:.2g} from the place (without: {push.idle:.2g})"
        + (", for it is as strong as --most lets it be" if push.bound else "")
    )
