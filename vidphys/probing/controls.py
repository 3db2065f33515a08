"""What a probe is compared with: without it, a good score says nothing of the encoder.

Some controls know what the encoder's training cannot have given: an encoder is *selective* for a
target by as much as it is better than the best of these rivals. The others take something away
from the encoder; what is lost says where the target was.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Control:
    """One of them.

    Args:
        name: as it stands in records.
        about: what it is, in words.
        lacks: what the difference from the score is owed to.
        rival: whether it is one that a score has to beat to say anything of the encoder.
    """

    name: str
    about: str
    lacks: str
    rival: bool


RANDOM, PIXELS, POOLED = "random-weights", "pixels", "pooled"
DISORDER, STILL, PERMUTED, CONSTANT = "disorder", "one-frame", "permuted", "constant"
CONTROLS = {
    control.name: control
    for control in (
        Control(RANDOM, "the same network before any training", "training", True),
        Control(PIXELS, "pixels of the frame and of those beside it", "the encoder", True),
        Control(PERMUTED, "labels exchanged between clips", "the labels", True),
        Control(CONSTANT, "the mean of what was trained on", "any feature", True),
        Control(POOLED, "the mean over all cells", "places in the map", False),
        Control(DISORDER, "all other frames of the clip in disorder", "the order of time", False),
        Control(STILL, "the frame alone, repeated", "motion", False),
    )
}
