"""Which bodies of a clip are followed: options that verbs share."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vidphys.errors import InputError

if TYPE_CHECKING:
    from binders.wanted import Wanted

HALF = 127  # brightness of a mask's pixel, above which it is looked at


@dataclass(frozen=True, kw_only=True)
class WhoOptions:
    """Which bodies are followed, where it is not plain. All pixels are those of the clip.

    Args:
        at: X,Y,FRAME, where a body is; several of one body or of different ones.
        region: X,Y,WIDTH,HEIGHT, in which bodies are looked for.
        colour: that the bodies have, a name or #rrggbb.
        size: diameter of the bodies in pixels.
        mask: a picture of the clip's size, whose white part is looked at.
        choose: numbers, from 1, of what may be a body, the likeliest first.
    """

    at: tuple[str, ...] = ()
    region: str | None = None
    colour: str | None = None
    size: float | None = None
    mask: Path | None = None
    choose: tuple[int, ...] = ()

    @property
    def given(self) -> tuple[str, ...]:
        """The options that were given."""
        names = (field.name for field in fields(WhoOptions))
        return tuple(name for name in names if getattr(self, name) not in (None, ()))

    def wanted(self) -> Wanted:
        """As the binder is told it.

        Raises:
            InputError: something that cannot be read.
        """
        from binders.wanted import Wanted

        at = tuple(_numbers("at", text, "X,Y,FRAME") for text in self.at)
        region = self.region and _numbers("region", self.region, "X,Y,WIDTH,HEIGHT")
        if self.size is not None and not self.size > 0:
            raise InputError(f"--size {self.size}: must be above 0 pixels")
        return Wanted(
            tuple((x, y, int(frame)) for x, y, frame in at),
            (region[0], region[1], region[2], region[3]) if region else None,
            None if self.colour is None else _colour(self.colour),
            self.size,
            None if self.mask is None else _mask(self.mask),
            self.choose,
        )


def _numbers(name: str, text: str, form: str) -> tuple[float, ...]:
    try:
        found = tuple(float(each) for each in text.split(","))
    except ValueError:
        found = ()
    if len(found) != form.count(",") + 1:
        raise InputError(f"--{name} {text}: write {form}, numbers without spaces")
    return found


def _colour(text: str) -> tuple[int, int, int]:
    from matplotlib.colors import to_rgb

    try:
        red, green, blue = (round(255 * each) for each in to_rgb(text.lower()))
    except ValueError as error:
        raise InputError(f"--colour {text}: write a name such as red, or #rrggbb") from error
    return red, green, blue


def _mask(path: Path) -> np.ndarray:
    from vidphys.data.formats.opencv import opencv

    cv2 = opencv()
    try:
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    except cv2.error:  # a picture of more pixels than any is let have
        picture = None
    if picture is None:
        raise InputError(f"--mask {path}: no picture that can be read; save it as PNG")
    return picture > HALF
