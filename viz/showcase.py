"""The arrays that a recording and a contact sheet are made of: names, shapes, checks, file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from registry.seal import are_sealed

SCHEMA_VERSION = "2"
Arrays = Mapping[str, np.ndarray]
ROLES = ("truth", "prediction", "counterfactual_truth", "counterfactual")
OF_THE_FILE = ("schema_version", "seal")  # of no interest beside a recording


def read_showcase(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """The arrays and the description that a run folder keeps in ``showcase/*.safetensors``.

    Raises:
        ValueError: the file cannot be read, is damaged or newer, or is not a showcase.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="numpy") as file:
            arrays = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
            meta = dict(file.metadata() or {})
    except (OSError, ValueError, TypeError, SafetensorError) as error:
        raise ValueError(
            f"showcase {path}: cannot be read ({error}); run the cell again"
        ) from error
    version = meta.get("schema_version", SCHEMA_VERSION)
    if version.isdecimal() and int(version) > int(SCHEMA_VERSION):
        raise ValueError(
            f"showcase {path}: schema version {version}, this vidphys reads {SCHEMA_VERSION}"
        )
    if not are_sealed(arrays, meta, SCHEMA_VERSION):
        raise ValueError(
            f"showcase {path}: damaged (its content does not fit its hash); delete it and run the "
            "cell again"
        )
    check_showcase(arrays)
    return arrays, {key: text for key, text in meta.items() if key not in OF_THE_FILE}


def check_showcase(showcase: Arrays) -> None:
    """Raise ValueError unless the arrays of a ladder cell are there and fit together."""
    energies = [f"energy_{role}" for role in ROLES]
    _require("showcase", showcase, ("times", "half_extent", *ROLES, *energies))
    _scalar("showcase", showcase, "half_extent")
    if "dt" in showcase:
        _scalar("showcase", showcase, "dt")
    steps = _instants("showcase", showcase, "times")
    bodies = np.shape(showcase["truth"])[1:2]
    for role in ROLES:
        _shape("showcase", showcase, role, (steps, *bodies, 2))
        _shape("showcase", showcase, f"energy_{role}", (steps,))
    if "energy_long" in showcase:
        _require("showcase", showcase, ("long_times",))
        count = _instants("showcase", showcase, "long_times")
        _shape("showcase", showcase, "energy_long", (count,))
    if "frames" in showcase:
        _require("showcase", showcase, ("frame_times", "track"))
        count = _pictures("showcase", showcase, "track")
        if "attention" in showcase:
            _attention("showcase", showcase, count, bodies)


def laws_of(meta: Mapping[str, str]) -> dict[str, str]:
    """What each role of a ladder's cell is called: by its law and whose it is."""
    held = f"G = {float(meta['coupling']):.3g}" if "coupling" in meta else "the trained law"
    flipped = "G = −1" if "coupling" in meta else "the flipped law"
    return {
        "truth": f"{held}, truth",
        "prediction": f"{held}, model",
        "counterfactual_truth": f"{flipped}, truth",
        "counterfactual": f"{flipped}, model",
        "long": f"{held}, model",
    }


def check_video(video: Arrays) -> None:
    """Raise ValueError unless the arrays of a real clip are there and fit together."""
    keys = ("frames", "frame_times", "readout", "rollout", "rollout_times", "half_extent")
    _require("video", video, keys)
    _scalar("video", video, "half_extent")
    count = _pictures("video", video, "readout")
    bodies = np.shape(video["readout"])[1]
    if "attention" in video:
        _require("video", video, ("attention_times",))
        _attention("video", video, _instants("video", video, "attention_times"), (bodies,))
    if "track" in video:
        _shape("video", video, "track", (count, bodies, 2))
    for role in ("rollout", "changed"):
        if role in video:
            _require("video", video, (f"{role}_times",))
            instants = _instants("video", video, f"{role}_times")
            _shape("video", video, role, (instants, bodies, 2))


def half_extent(arrays: Arrays) -> float:
    """The world length of half of the longer image side."""
    return scalar(arrays, "half_extent")


def scalar(arrays: Arrays, key: str) -> float:
    """A single number, however it was shaped."""
    return float(np.asarray(arrays[key]).reshape(()))


def context(showcase: Arrays) -> tuple[np.ndarray, np.ndarray]:
    """What is known of the time until t = 0: instants ``(C,)`` and positions ``(C, N, 2)``.

    The truth if the arrays begin before t = 0, else what was perceived, else nothing.
    """
    times = np.asarray(showcase["times"], np.float64)
    if times[0] >= 0 and "track" in showcase:
        return np.asarray(showcase["frame_times"], np.float64), np.asarray(showcase["track"])
    before = times <= 0 if times[0] < 0 else np.zeros(len(times), bool)
    return times[before], np.asarray(showcase["truth"])[before]


def zoom_extent(showcase: Arrays) -> float:
    """Half the side of the square that holds what truly happens, at most the viewport's."""
    shown = (context(showcase)[1], showcase["truth"], showcase["counterfactual_truth"])
    reach = max(float(np.nanmax(np.abs(part), initial=0.0)) for part in shown)
    return min(half_extent(showcase), 1.15 * reach)


def _require(who: str, arrays: Arrays, keys: Sequence[str]) -> None:
    missing = [key for key in keys if key not in arrays]
    if missing:
        raise ValueError(f"{who}: expected {', '.join(keys)}; missing {', '.join(missing)}")


def _scalar(who: str, arrays: Arrays, key: str) -> None:
    if np.size(arrays[key]) != 1 or not np.all(np.asarray(arrays[key]) > 0):
        raise ValueError(f"{who}: {key} must be one positive number, got {arrays[key]}")


def _shape(who: str, arrays: Arrays, key: str, expected: tuple[int, ...]) -> None:
    if np.shape(arrays[key]) != expected:
        got = np.shape(arrays[key])
        raise ValueError(f"{who}: {key} must have shape {expected}, got {got}")


def _attention(who: str, arrays: Arrays, frames: int, bodies: tuple[int, ...]) -> None:
    """Shares of a grid over the picture, for each frame and body."""
    grid = (*np.shape(arrays["attention"])[2:], 1, 1)[:2]
    _shape(who, arrays, "attention", (frames, *bodies, *grid))


def _instants(who: str, arrays: Arrays, key: str) -> int:
    times = np.asarray(arrays[key])
    if times.ndim != 1 or len(times) < 2 or not np.all(np.diff(times) > 0):
        raise ValueError(
            f"{who}: {key} must be two or more increasing instants (seconds), "
            f"got an array of shape {times.shape}"
        )
    return len(times)


def _pictures(who: str, arrays: Arrays, seen: str) -> int:
    frames = arrays["frames"]
    count = _instants(who, arrays, "frame_times")
    if frames.ndim != 4 or frames.shape[-1] != 3 or frames.dtype != np.uint8:
        raise ValueError(
            f"{who}: frames must be uint8 (F, H, W, 3), got {frames.dtype} {frames.shape}"
        )
    track = np.shape(arrays[seen])
    if len(frames) != count or len(track) != 3 or track[0] != count or track[2] != 2:
        raise ValueError(
            f"{who}: {count} frame times, {len(frames)} frames and a {seen} of shape {track} "
            "do not belong together; expected (F,), (F, H, W, 3), (F, N, 2)"
        )
    return count
