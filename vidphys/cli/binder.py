"""What the hand-made binder of clips is told, from the command line."""

from __future__ import annotations

from binders.motion import MotionSettings
from vidphys.errors import InputError


def binder_settings(bodies: int, shadow: float) -> MotionSettings:
    """See :class:`binders.motion.MotionSettings`.

    Raises:
        InputError: numbers that make no sense.
    """
    try:
        return MotionSettings(bodies=bodies, shadow=shadow)
    except ValueError as error:
        raise InputError(f"--{error}") from error
