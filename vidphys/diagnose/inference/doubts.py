"""Why an answer is not told as sure, and what recording would tell."""

from __future__ import annotations

import numpy as np

from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.inference.linearised import resolved
from vidphys.diagnose.recordings.motion import Motion


def mistaken(inference: Inference, swaps: int) -> str:
    """What else looks like a force that the menu lacks, and what to do; empty if nothing does.

    Args:
        inference: of a motion.
        swaps: of names, that were mended before.
    """
    if swaps:
        return "a swap of names that was missed looks like one: look at what is followed"
    if inference.kicks and "dry" in inference.kinds:
        return "a body that dry friction stops looks like one: record more often"
    return ""


def doubts(motion: Motion, inference: Inference, swaps: int = 0) -> list[str]:
    """A sentence for each doubt, with the experiment that would end it.

    Args:
        motion: that was looked at.
        inference: of it.
        swaps: of names, that were mended before.
    """
    said, rest = [], inference.leftover
    if rest.explained and not rest.even:
        said.append(
            "Not told as sure: some stretches fit far worse than others; look there for swapped "
            "names and contacts, or record these moments at a higher frame rate."
        )
    if rest.explained and inference.rivalled:
        said.append(
            "Not told as sure: other terms fit as well and lose by their number alone; start the "
            "bodies elsewhere and faster, or record longer."
        )
    if rest.explained and inference.between:
        said.append(
            "Not told as sure: a force between the bodies by a power of the distance that is no "
            "whole number explains as much alone; record bodies nearer to each other and farther "
            "apart."
        )
    if rest.explained and inference.smoothly:
        said.append(
            "Not told as sure: a force that the menu lacks explains about as much as random kicks; "
            "record more often, and longer."
        )
    if rest.explained and inference.alone:
        kinds = " and ".join(sorted(inference.alone))
        said.append(
            f"Not told as sure: one stretch alone speaks for {kinds}; record more of what happens "
            "there."
        )
    if rest.explained and inference.slight:
        kinds = " or ".join(sorted(inference.slight))
        said.append(
            f"Not told as sure: {kinds} may be there too, and explains more than chance does, but "
            "too little to be told; record longer, or with less noise."
        )
    if rest.explained and rest.unseen:
        share = f"{2 * rest.hidden[rest.unseen]:.0%}"
        said.append(
            f"Not told as sure: {rest.unseen} may be there, up to {share} of what was found, and "
            "would not show; record longer, or with less noise."
        )
    other = mistaken(inference, swaps)
    if not rest.explained and other:
        said.append(f"Nor is it sure that the menu lacks a force: {other}.")
    elif not rest.explained and not (rest.certain and resolved(inference)):
        several = motion.bodies > 1 and np.allclose(motion.mass, 1.0)
        why = "give the masses, or " if several else ""
        said.append(
            f"Nor is it sure that the menu lacks a force: {why}record with less noise and more "
            "often, and ask again."
        )
    return said
