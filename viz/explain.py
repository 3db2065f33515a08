"""What a reader of the report has to know, in plain words."""

from __future__ import annotations

from viz.summary import SKILL_BAR, Records


def how_to_read() -> list[str]:
    """What the numbers are and what they do not say, a paragraph each."""
    return [
        "Every model saw one law only (coupling G > 0). At the moment t = 0 the coupling is "
        "changed, and the model is asked to roll the bodies forward under a law that it never "
        "met. A rung is where its positions and momenta came from: the truth (oracle), or "
        "pictures read by an encoder, a binder and a readout. Rows of one rung differ only in "
        "the head that rolls the state forward; differencing and shooting are two ways to get "
        "momenta from the same positions, so compare within one of them.",
        "Inversion nMSE is the squared error against the true rollout under the changed law, over "
        "that rollout's variance. Regime match asks less: is the rollout nearer to the changed "
        "law's truth than to the old law's? A model without any force passes that test at short "
        "horizons, so it proves little alone; gated counts the seeds that also beat that model. "
        "Ballistic skill is what counts: the error over that of a predictor with no force at all "
        f"from the same start; below {SKILL_BAR:g} the model knows something about the changed "
        "law, at 1 or above it knows nothing. The force cosine compares directions of learned and "
        "true force: 1 is right, -1 reversed.",
        "Energy drift is the change of the true energy along the model's own long rollout under "
        "the trained law, relative to its start: median episode (median over the seeds) and "
        "the worst episode of any seed. p is the exact probability of a match on every seed if "
        "each were a fair coin.",
        "A word in place of a number is a status: failed (something became non-finite, which is "
        "counted and never averaged), invalid (perception was too poor to compare), void (a "
        "positive control failed), skipped (not run). A dash was not measured. Hover over a "
        "number for more digits; records.parquet has all of them.",
    ]


def what_spread_means(records: Records) -> str:
    """What stands under a mean: an interval, a range, or nothing, by the number of seeds."""
    count = max(len(records.seeds(line)) for line in records.lines)
    return (
        "Brackets hold the 95 % interval of the mean (normal approximation, five seeds or more): "
        "not a range of outcomes, and overlap alone says nothing about significance."
        if count >= 5
        else "With fewer than five seeds there is no interval: the smallest and the largest value "
        "are shown, as a range."
        if count > 1
        else "There is one seed, so nothing here says how much a number would vary."
    )
