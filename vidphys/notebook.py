"""``%load_ext vidphys``: a rollout, a head and a diagnosis show themselves in a notebook.

A run does so by itself. The others are made in rooms that know nothing of pages, so that IPython is
told here how to show them, by the names of their classes.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

if TYPE_CHECKING:
    from dynamics.head import Head
    from dynamics.rolling import Rollout
    from vidphys.diagnose.diagnosis import Diagnosis
    from vidphys.diagnose.telling.answered import Answered

SIDE, EDGE = 260, 12  # of the drawing, pixels
POINTS = 400  # of a track, at most
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # Okabe and Ito's


def load_ipython_extension(shell: Any) -> None:
    """Tell IPython how ours are shown; ``%load_ext vidphys`` calls it."""
    page = shell.display_formatter.formatters["text/html"]
    page.for_type_by_name("dynamics.rolling", "Rollout", rollout_html)
    page.for_type_by_name("dynamics.head", "Head", head_html)
    page.for_type_by_name("vidphys.diagnose.diagnosis", "Diagnosis", diagnosis_html)
    page.for_type_by_name("vidphys.diagnose.telling.answered", "Answered", answered_html)


def rollout_html(found: Rollout) -> str:
    """Where the bodies of the first episode go, and what is to be said of all of them."""
    batch = tuple(found.first_bad.shape)
    rows = {
        "episodes": found.first_bad.numel(),
        "bodies": found.states.q.shape[-2],
        "lasts": f"{float(found.times[-1]):.4g} s, in {found.states.q.shape[-3]} stored states",
        "status": found.status,
        "computed by": found.backend,
    }
    said = [finding.text for finding in found.findings]
    first = found.states.q[(0,) * len(batch)].detach().double().cpu().numpy()
    return _shown("Rollout", rows, said, _tracks(first))


def head_html(head: Head) -> str:
    """What a model is made of, and how much of it is learned."""
    rows = {
        "kind": type(head).__name__,
        "parts": ", ".join(f"{name}: {type(part).__name__}" for name, part in head.named_children())
        or "none",
        "parameters": f"{sum(p.numel() for p in head.parameters()):,}",
        "step": "any" if head.dt is None else f"{head.dt:.4g} s, one application of a map",
    }
    return _shown("Head", rows)


def diagnosis_html(found: Diagnosis) -> str:
    """Which terms a motion requires, and whether they explain it."""
    if found.refused:
        return _shown("Diagnosis", {}, [f"No answer: {found.refused}."])
    rows = {
        "explained": "yes" if found.explained else "no",
        "terms": ", ".join(sorted(found.kinds)) or "none",
        "told": "without a doubt" if found.told else "with others that are possible",
        "frames": found.motion.positions.shape[-3],
        "noise": f"{found.noise.sigma:.3g}",
    }
    return _shown("Diagnosis", rows)


def answered_html(found: Answered) -> str:
    """What is said of a recording, line by line."""
    return _shown("Diagnosis", {}, found.lines)


def _shown(
    title: str, rows: dict[str, Any], said: Iterable[str] = (), drawing: Markup | None = None
) -> str:
    cells = Markup().join(
        Markup("<tr><th style='text-align: left'>{}</th><td>{}</td></tr>").format(name, value)
        for name, value in rows.items()
    )
    lines = Markup().join(Markup("<p>{}</p>").format(line) for line in said)
    return str(
        Markup("<div><strong>{}</strong>{}<table>{}</table>{}</div>").format(
            title, drawing or "", cells, lines
        )
    )


def _tracks(places: Any) -> Markup:
    """Lines of ``(t, n, d)``, to scale; one coordinate is drawn over time."""
    import numpy as np

    t, n, d = places.shape
    when = np.broadcast_to(np.linspace(0, 1, t)[:, None], (t, n))
    across, up = (when, places[..., 0]) if d == 1 else (places[..., 0], places[..., 1])
    seen = np.isfinite(across) & np.isfinite(up)
    if not seen.any():
        return Markup("<p>No state is finite.</p>")
    sizes = [max(float(np.ptp(x[seen])), 1e-9) for x in (across, up)]
    wide, high = sizes if d == 1 else [max(sizes)] * 2
    x = EDGE + (across - across[seen].min()) / wide * (SIDE - 2 * EDGE)
    y = SIDE - EDGE - (up - up[seen].min()) / high * (SIDE - 2 * EDGE)
    lines = Markup()
    for body in range(n):
        kept = np.flatnonzero(seen[:, body])[:: max(t // POINTS, 1)]
        points = " ".join(f"{x[k, body]:.1f},{y[k, body]:.1f}" for k in kept)
        lines += Markup('<polyline points="{}" fill="none" stroke="{}" stroke-width="2"/>').format(
            points, COLOURS[body % len(COLOURS)]
        )
    label = Markup('<svg role="img" aria-label="tracks of the first episode" width="{0}" ').format(
        SIDE
    )
    return label + Markup('height="{0}" viewBox="0 0 {0} {0}">{1}</svg>').format(SIDE, lines)
