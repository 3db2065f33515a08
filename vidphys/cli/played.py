"""The episode that is looked at on the page of ``play``, as a recording of rerun's."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vidphys.cli.recordings import told_law

if TYPE_CHECKING:
    from vidphys.play import Asked, Piece, Stage

MOST_INSTANTS = 101  # of a role
ENERGIES = {"truth true": "truth", "model true": "model", "model own": "own"}


def write_played(stage: Stage, asked: Asked, path: Path) -> None:
    """Write what was asked as a recording.

    Args:
        stage: it is rolled on.
        asked: the change, and the episode.
        path: the ``.rrd``.

    Raises:
        InputError: something that this model cannot be asked.
    """
    from vidphys.play import answers
    from viz.rolled import Rolled, write_rolled_recording

    pieces = [piece for piece in answers(stage, asked) if piece and piece.about["role"] != "table"]
    rolled, status = Rolled(), "ok"
    for role in dict.fromkeys(piece.about["role"] for piece in pieces):
        ours = [p for p in pieces if p.about["role"] == role and p.places is not None]
        if ours:
            rolled.ways[role] = _way(ours, asked.episode)
        for name in dict.fromkeys(name for p in ours for name in p.about.get("energy", {})):
            key = ENERGIES[f"{role} {name}"]
            rolled.energies[key] = _energy(ours, name)
    if {"own", "model"} <= rolled.energies.keys():  # known up to a constant
        (times, own), (_, true) = rolled.energies["own"], rolled.energies["model"]
        rolled.energies["own"] = times, own + (true[0] - own[0])
    model = [piece.about for piece in pieces if piece.about["role"] == "model"]
    for key, text in (("left", "left its valid range"), ("bad", "not finite")):
        at = [a["first"] + k for a in model if (k := a[key][asked.episode - a["episode"]]) >= 0]
        if at:
            rolled.marks[at[0] * model[0]["dt"]], status = text, text
    factors = [f"{name}={factor:g}" for name, factor in asked.factors.items() if factor != 1]
    law = told_law(asked.coupling, factors) or "each number its own"
    about = {
        "cell": f"{stage.name} episode {asked.episode}",
        "law": law,
        "start": "moved by hand" if asked.q or asked.v else "as it was drawn by lot",
        "integrator": asked.integrator or "the model's own",
        "steps": f"{model[0]['steps']} of {model[0]['dt'] / model[0]['every']:.4g} s",
        "status": status,
    }
    write_rolled_recording(rolled, about, path)


def _way(pieces: list[Piece], episode: int) -> tuple[np.ndarray, np.ndarray]:
    """Times and places in the plane of the picture, thinned."""
    first = pieces[0].about["episode"]
    parts = [p.places[episode - first].double().numpy() for p in pieces if p.places is not None]
    places = np.concatenate(parts)[..., :2]
    places = np.pad(places, [(0, 0), (0, 0), (0, 2 - places.shape[-1])])  # of one dimension
    return _thinned(pieces, places)


def _energy(pieces: list[Piece], name: str) -> tuple[np.ndarray, np.ndarray]:
    values = [v for piece in pieces for v in piece.about["energy"].get(name, [])]
    return _thinned(pieces, np.array(values, np.float64))


def _thinned(pieces: list[Piece], values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    every = max(1, -(-len(values) // MOST_INSTANTS))
    times = pieces[0].about["dt"] * np.arange(len(values))
    return times[::every], values[::every]
