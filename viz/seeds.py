"""One episode as each seed's model rolls it: side by side, on one clock."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from viz.layout import clock, growing
from viz.overlay import BODY_COLOURS
from viz.showcase import ROLES, Arrays, half_extent, laws_of, zoom_extent
from viz.story import ROLLED
from viz.tape import COLOURS, Tape

if TYPE_CHECKING:
    import rerun.blueprint as rrb

LAWS = (ROLES[:2], ROLES[2:])  # roles under the law that held, and under the other


def write_seeds_recording(seeds: Mapping[int, Arrays], meta: Mapping[str, str], path: Path) -> None:
    """Write the recording of one episode under both laws, by the model of each seed.

    Args:
        seeds: for each ``times (T,)`` in seconds, ``truth``, ``prediction``,
            ``counterfactual_truth`` and ``counterfactual`` ``(T, N, 2)`` in world units, y upwards;
            ``half_extent`` in world units. Non-finite instants are left blank.
        meta: what is shown, in words; ``cell`` becomes the recording's name.
        path: the ``.rrd`` to write, replaced as a whole or not at all.

    Raises:
        ValueError: there is no seed.
    """
    if not seeds:
        raise ValueError("seeds: there must be one at least")
    first = next(iter(seeds.values()))
    times = np.asarray(first["times"], np.float64)
    shown = {f"seed/{seed}": f"seed {seed}" for seed in seeds}
    tape = Tape(meta, float(np.median(np.diff(times))), laws_of(meta), shown)
    tape.turn_upright("seed")
    zoom = min(half_extent(first), max(zoom_extent(arrays) for arrays in seeds.values()))
    for k, (seed, arrays) in enumerate(seeds.items()):
        for role in ROLES:
            radius = zoom * (0.035 if role.endswith("truth") else 0.02)
            entity = f"seed/{seed}/{role}"
            tape.bodies(entity, arrays["times"], arrays[role], [COLOURS[role]], radius)
        hue = BODY_COLOURS[k % len(BODY_COLOURS)]
        for truth, guess in LAWS:
            gap = np.linalg.norm(np.subtract(arrays[guess], arrays[truth]), axis=-1).mean(-1)
            tape.line(f"distance/{guess}/{seed}", arrays["times"], gap, f"seed {seed}", hue)
    tape.phases({float(times[0]): ROLLED})
    laws = [tape.names[truth].removesuffix(", truth") for truth, _ in LAWS]
    tape.save(path, _layout(list(seeds), laws, zoom, times))


def _layout(seeds: list[int], laws: list[str], zoom: float, times: np.ndarray) -> rrb.Blueprint:
    """A column a seed, a row a law; at its end the mean distances of the bodies from the truth."""
    import rerun.blueprint as rrb

    square = rrb.VisualBounds2D(x_range=(-zoom, zoom), y_range=(-zoom, zoom))

    def world(seed: int, law: str, roles: tuple[str, ...]) -> rrb.Spatial2DView:
        entities = [f"seed/{seed}/{role}" for role in roles]
        return rrb.Spatial2DView(
            origin="/",
            contents=[f"+ /{entity}/**" for entity in entities],
            name=f"{law}, seed {seed}",
            visual_bounds=square,
            overrides={f"{entity}/trail": growing() for entity in entities},
        )

    rows = []
    for law, roles in zip(laws, LAWS, strict=True):
        away = rrb.TimeSeriesView(origin=f"/distance/{roles[1]}", name=f"{law}, off by")
        rows.append(rrb.Horizontal(*(world(seed, law, roles) for seed in seeds), away, name=law))
    about = rrb.TextDocumentView(origin="/about", name="About")
    panels = rrb.BlueprintPanel(state="collapsed"), rrb.SelectionPanel(state="collapsed")
    window = float(times[0]), float(times[-1])
    return rrb.Blueprint(rrb.Vertical(*rows, about, row_shares=[5, 5, 2]), clock(window), *panels)
