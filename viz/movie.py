"""One episode of a cell as a film for slides: what was seen, both laws, and their energies."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from viz.diagnosis import HUES
from viz.mp4 import draw_mp4
from viz.overlay import energy_range, world_to_pixel
from viz.showcase import Arrays, check_showcase, half_extent, laws_of
from viz.whole import whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SECONDS, RATE = 8.0, 25  # of the film; frames a second
GIF_RATE = 12
SEEN_SHARE = 0.25  # of the film in which the clip is watched, where there is one
SIZE, DOTS = (12.8, 7.2), 100  # inches, and pixels of an inch: 1280 by 720
GREY = "#777777"
KINDS = (".mp4", ".gif", ".png")


def write_movie(showcase: Arrays, meta: Mapping[str, str], path: Path) -> None:
    """Write an episode as ``.mp4`` or ``.gif``, or its last picture as ``.png``.

    Args:
        showcase: the arrays of a cell, as :func:`viz.recording.write_recording` takes them.
        meta: what is shown, in words; ``cell`` becomes the title.
        path: of the file, replaced as a whole or not at all.

    Raises:
        ValueError: another ending, arrays that are wrong, or no codec for such a film.
    """
    if path.suffix not in KINDS:
        raise ValueError(f"a movie ends in {', '.join(KINDS)}, not in '{path.suffix}'")
    check_showcase(showcase)
    figure, draw, count = _scene(showcase, meta)
    with whole(path) as part:
        if path.suffix == ".png":
            draw(count - 1)
            figure.savefig(part, dpi=DOTS)
        elif path.suffix == ".gif":
            _as_gif(part, list(_pictures(figure, draw, count, GIF_RATE)))
        else:
            size = round(DOTS * SIZE[0]), round(DOTS * SIZE[1])
            draw_mp4(part, _pictures(figure, draw, count, RATE), RATE, size)


def _pictures(
    figure: Figure, draw: Callable[[int], None], count: int, rate: int
) -> Iterator[np.ndarray]:
    """Pictures ``(H, W, 3)``, spread evenly over the moments that there are."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    for k in np.linspace(0, count - 1, round(SECONDS * rate)).round().astype(int):
        draw(int(k))
        canvas.draw()
        figure.set_layout_engine("none")  # it stays as it is, and takes long to find
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _as_gif(path: Path, pictures: list[np.ndarray]) -> None:
    from PIL import Image

    first, *others = (Image.fromarray(x).resize((640, 360)).quantize(64) for x in pictures)
    first.save(path, "GIF", save_all=True, append_images=others, duration=1000 // GIF_RATE, loop=0)


def _scene(showcase: Arrays, meta: Mapping[str, str]) -> tuple[Figure, Callable[[int], None], int]:
    """The figure, what draws one of its moments into it, and how many there are."""
    import matplotlib
    from matplotlib.figure import Figure

    after = np.asarray(showcase["times"]) >= 0
    times = np.asarray(showcase["times"])[after]
    seen = len(showcase["frames"]) if "frames" in showcase else 0
    watched = round(len(times) * SEEN_SHARE / (1 - SEEN_SHARE)) if seen else 0
    names = laws_of(meta)
    with matplotlib.rc_context({"font.size": 13, "axes.edgecolor": "#bbbbbb"}):
        figure = Figure(figsize=SIZE, layout="constrained")
        above = ["clip", "law", "flip"] if seen else ["law", "flip"]
        rows: Any = [above, ["energy"] * len(above)]
        panels: Any = figure.subplot_mosaic(rows, height_ratios=[2, 1])
    figure.suptitle(meta.get("cell", ""), x=0.01, ha="left", fontsize=16, weight="bold")
    clip = _clip(panels["clip"], showcase) if seen else None
    parts = [
        _law(panels["law"], showcase, after, ("truth", "prediction"), names),
        _law(panels["flip"], showcase, after, ("counterfactual_truth", "counterfactual"), names),
        _energies(panels["energy"], showcase, after, times, names),
    ]

    def draw(moment: int) -> None:
        if clip is not None:
            clip(min(seen - 1, moment * seen // max(watched, 1)))
        for part in parts:
            part(max(0, moment - watched))

    return figure, draw, watched + len(times)


def _clip(axes: Any, showcase: Arrays) -> Callable[[int], None]:
    frames, extent = showcase["frames"], half_extent(showcase)
    height, width = frames.shape[1:3]
    track = world_to_pixel(showcase["track"], (height, width), extent)
    picture = axes.imshow(frames[0], extent=(0, width, height, 0), interpolation="nearest")
    dots = [
        axes.plot([], [], "o", mfc="none", mec=_hue(n), ms=10)[0] for n in range(track.shape[1])
    ]
    axes.set(title="seen", xticks=[], yticks=[])

    def draw(k: int) -> None:
        picture.set_data(frames[k])
        for n, dot in enumerate(dots):
            dot.set_data(*track[k, n, :, None])

    return draw


def _law(
    axes: Any, showcase: Arrays, after: np.ndarray, roles: tuple[str, str], names: Mapping[str, str]
) -> Callable[[int], None]:
    """Truth in grey, the model in the hue of each body, up to a moment."""
    truth, model = (np.asarray(showcase[role], np.float64)[after] for role in roles)
    bodies = truth.shape[1]
    grey = [axes.plot([], [], color=GREY, lw=6, alpha=0.45)[0] for _ in range(bodies)]
    ways = [axes.plot([], [], color=_hue(n), lw=2.4)[0] for n in range(bodies)]
    dots = [axes.plot([], [], "o", color=_hue(n), ms=9)[0] for n in range(bodies)]
    both = np.concatenate(
        [np.asarray(showcase[key])[after] for key in ("truth", "counterfactual_truth")]
    )
    low, high = np.nanmin(both, axis=(0, 1)), np.nanmax(both, axis=(0, 1))
    centre, half = (low + high) / 2, 0.6 * float(np.max(high - low))
    axes.set(xlim=(centre[0] - half, centre[0] + half), ylim=(centre[1] - half, centre[1] + half))
    law = names[roles[1]].removesuffix(", model")
    axes.set(aspect="equal", xticks=[], yticks=[], title=f"{law} (grey: the truth)")

    def draw(k: int) -> None:
        for n in range(bodies):
            grey[n].set_data(*truth[: k + 1, n].T)
            ways[n].set_data(*model[: k + 1, n].T)
            dots[n].set_data(*model[k, n, :, None])

    return draw


def _energies(
    axes: Any, showcase: Arrays, after: np.ndarray, times: np.ndarray, names: Mapping[str, str]
) -> Callable[[int], None]:
    looks = {
        "truth": {"color": GREY, "lw": 5, "alpha": 0.45},
        "prediction": {"color": HUES[0], "lw": 2.2},
        "counterfactual_truth": {"color": GREY, "lw": 5, "alpha": 0.45, "ls": "--"},
        "counterfactual": {"color": HUES[1], "lw": 2.2, "ls": "--"},
    }
    values = {role: np.asarray(showcase[f"energy_{role}"], np.float64)[after] for role in looks}
    lines = {role: axes.plot([], [], label=names[role], **look)[0] for role, look in looks.items()}
    truths = np.concatenate([values["truth"], values["counterfactual_truth"]])
    span = float(np.ptp(truths)) or 1.0
    low, high = float(truths.min()) - 0.5 * span, float(truths.max()) + 0.5 * span
    axes.set(xlim=(times[0], times[-1]), ylim=energy_range(low, high))
    axes.set(xlabel="seconds since the law may change", ylabel="energy")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=11)

    def draw(k: int) -> None:
        for role, line in lines.items():
            line.set_data(times[: k + 1], values[role][: k + 1])

    return draw


def _hue(body: int) -> str:
    return HUES[body % len(HUES)]
