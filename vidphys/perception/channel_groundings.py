"""The rungs of the ladder that are given one channel per body."""

from __future__ import annotations

from vidphys.perception.base import BODY, CENTROIDS, CHANNELS, LABELS, UNTOLD, Grounding
from vidphys.perception.cnn import fit_supervised
from vidphys.perception.discovered import fit_discovered
from vidphys.perception.jepa import fit_jepa, fit_jepa_centroid, fit_jepa_exact
from vidphys.perception.synthesis import fit_synthesis

CHANNEL_GROUNDINGS = [
    Grounding("renderer", "channel", "none", "none", False, fit_synthesis, UNTOLD, BODY),
    Grounding("cnn-supervised", "channel", "cnn", "none", False, fit_supervised, LABELS, CHANNELS),
    Grounding("cnn-discovered", "channel", "cnn", "none", True, fit_discovered, UNTOLD, BODY),
    Grounding("jepa", "channel", "jepa", "none", True, fit_jepa, UNTOLD, CHANNELS),
    Grounding(
        "jepa-centroid", "channel", "jepa", "none", True, fit_jepa_centroid, CENTROIDS, CHANNELS
    ),
    Grounding("jepa-exact", "channel", "jepa", "none", True, fit_jepa_exact, LABELS, CHANNELS),
]
