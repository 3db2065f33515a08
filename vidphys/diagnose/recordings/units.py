"""What positions are counted in, for people: pixels, metres, radians, or nothing that is known."""

from __future__ import annotations

from dataclasses import dataclass

GRAVITY = 9.81  # m/s^2, at the ground


@dataclass(frozen=True)
class Units:
    """The unit in which lengths are told.

    Args:
        name: of it, or empty.
        per: of it in one unit of the positions.
    """

    name: str = ""
    per: float = 1.0

    def told(self, value: float, length: int) -> float:
        """A number that goes with a power of length."""
        return value * self.per**length

    def named(self, length: int, seconds: int) -> str:
        """The unit of a number that goes with powers of length and of seconds."""
        over = [
            f"{name}{'²' if -power == 2 else ''}"
            for name, power in ((self.name, length), ("s", seconds))
            if power < 0 and name
        ]
        above = self.name if length > 0 else "s" if seconds > 0 else ""
        if not over:
            return above
        return f"{above or '1'}/{'/'.join(over)}"
