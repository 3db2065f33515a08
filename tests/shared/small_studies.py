"""Sizes of a study that a test can wait for."""

from vidphys.presets import OracleSizes, PixelSizes, Preset

TINY = Preset(
    seeds=1,
    oracle=OracleSizes(32, 12, 64, (5e-3,), 4),
    pixel=PixelSizes(
        clips=10,
        frames=9,
        stride=40,
        image=32,
        perception_steps=3,
        perception_batch=8,
        track_steps=4,
        held_out=4,
    ),
)
