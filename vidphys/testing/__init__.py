"""Checkers of parts, for a stranger's tests: who passes its checker works in every verb.

Each returns nothing, or raises :class:`CheckFailed` with one line: what was expected, what came.

Example:
    >>> from dynamics import terms
    >>> from vidphys.testing import check_term
    >>> check_term(terms.Trap(2.0))
"""

from vidphys.testing.binders import check_binder
from vidphys.testing.encoders import check_encoder
from vidphys.testing.failed import CheckFailed
from vidphys.testing.formats import check_format
from vidphys.testing.heads import check_head
from vidphys.testing.readouts import check_readout
from vidphys.testing.scenes import check_scene
from vidphys.testing.terms import check_term

__all__ = [
    "CheckFailed",
    "check_binder",
    "check_encoder",
    "check_format",
    "check_head",
    "check_readout",
    "check_scene",
    "check_term",
]
