"""Laws that are nearly as likely as the one that is told, and what would tell them apart."""

from __future__ import annotations

from vidphys.diagnose.explanations.doubts import doubts, seen
from vidphys.diagnose.explanations.law_words import bodies_named, in_short
from vidphys.diagnose.mechanisms.fitted import Fit
from vidphys.diagnose.mechanisms.mechanism import Group, Mechanism

CLEAR = 4.0  # of log likelihood after its price, within which another law may be the true one
LASTING = 2.0  # times that, where errors last: what they are like is known less well
# The same where a camera saw it: in clips filmed for development wrong forms of friction led by up
# to 20, and of the right ones that were explained 3 of 43 led by less.
SEEN = 20.0


def near(group: Group) -> list[Fit]:
    """Laws of other terms that may be the true one."""
    lasts = group.fit.errors.smooth > group.fit.errors.white
    clear = CLEAR * (LASTING if lasts else 1.0)
    least = group.fit.score - (SEEN if seen(group.fit) else clear)
    return [x for x in group.others if x.score > least and x.kinds != group.fit.kinds]


def undecided(mechanism: Mechanism) -> bool:
    """Whether another law does as well: one without a term that is told, or one that is known by
    its kind.

    One that has another term beside those that are told is no doubt of them, but for a friction of
    what swings: nothing swings for ever.
    """
    for group in mechanism.groups:
        if any(swings_on(group.fit) or not x.kinds > group.fit.kinds for x in near(group)):
            return True
    return any(doubts(group.fit) for group in mechanism.groups)


def swings_on(fit: Fit) -> bool:
    """Whether it swings, and no friction is told."""
    law = fit.model.law
    return law.restoring in ("trap", "pendulum") and not law.frictions


def rivals(mechanism: Mechanism) -> list[str]:
    """Of laws that are nearly as likely, in sentences; where there are several, of which bodies."""
    out = []
    for group in mechanism.groups:
        kinds = {in_short(x.kinds) for x in near(group)}
        said = doubts(group.fit)
        if kinds:
            alike = "; or ".join(sorted(kinds))
            said = [f"Nearly as likely: {alike}. A longer recording would tell.", *said]
        if len(mechanism.groups) > 1:
            said = [x.replace(":", f", {bodies_named(group.bodies).lower()}:", 1) for x in said]
        out += said
    return out
