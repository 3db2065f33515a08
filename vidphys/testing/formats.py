"""Whether a file format keeps its contract."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from vidphys.data.formats import FORMATS, ClipFormat, Format, Recording, TrackFormat
from vidphys.errors import InputError
from vidphys.testing.failed import CheckFailed, expect


def check_format(format: str | Format, path: Path) -> None:
    """Check a format on a file of it: everything that `diagnose`, `train` and `extract` rely on.

    It knows its file and no other; what it reads has the promised shapes, the same twice, with
    seconds that increase; a file of something else ends in one line.

    Args:
        format: a registered name, a ``package.module:attribute``, or a format.
        path: a file of it, with at least two frames.

    Raises:
        CheckFailed: what was expected, and what came.
    """
    made = FORMATS[format] if isinstance(format, str) else format
    name = f"format {' '.join(made.suffixes)}"
    for suffix in made.suffixes:
        good = suffix.startswith(".") and suffix == suffix.lower()
        expect(good, f"{name}: suffixes", "lower case, with the dot", suffix)
    expect(made.sniff(path), f"{name}.sniff", f"{path.name} to be of it", "no")
    expect(not made.sniff(path.with_suffix(".xyz")), f"{name}.sniff", "no other suffix", ".xyz")
    if isinstance(made, TrackFormat):
        _check_tracks(made, name, path)
    elif isinstance(made, ClipFormat):
        _check_clip(made, name, path)
    else:
        raise CheckFailed(f"a format: expected a TrackFormat or a ClipFormat, got {made!r}")
    with tempfile.TemporaryDirectory() as folder:
        for number, content in enumerate((b"", b"\x00\xffno file of this kind\n")):
            wrong = Path(folder) / f"wrong{number}{path.suffix}"
            wrong.write_bytes(content)
            if made.sniff(wrong):
                _expect_refusal(made, wrong, name)


def _expect_refusal(made: TrackFormat | ClipFormat, wrong: Path, name: str) -> None:
    try:
        if isinstance(made, TrackFormat):
            found: object = made.read(wrong, {}, None)
        else:
            found = list(made.read(wrong)[2])
    except (ValueError, InputError) as error:
        expect("\n" not in str(error), f"{name} of another file", "an error of one line", error)
        return
    except Exception as error:
        raise CheckFailed(
            f"{name} of another file: expected a ValueError of one line, got {error!r}"
        ) from error
    raise CheckFailed(f"{name} of another file: expected a ValueError, got {type(found).__name__}")


def _check_tracks(made: TrackFormat, name: str, path: Path) -> None:
    found, again = made.read(path, {}, 0.04), made.read(path, {}, 0.04)
    expect(isinstance(found, Recording), name, "a formats.Recording", type(found).__name__)
    q, times = found.positions, found.times
    expect(q.ndim == 4, f"{name}: positions", "(clips, frames, bodies, space)", q.shape)
    expect(q.dtype == np.float64, f"{name}: positions", "float64", q.dtype)
    expect(bool(np.isfinite(q).any()), f"{name}: positions", "a body that is seen", "none")
    expect(not np.isinf(q).any(), f"{name}: positions", "NaN where a body is not seen", "infinity")
    same = np.array_equal(q, again.positions, equal_nan=True)
    expect(same, name, "the same twice", "another answer")
    expect(found.unit in ("world", "pixels", "angles"), f"{name}: unit", "a known one", found.unit)
    expect(times is not None, f"{name}: times", "seconds, where an interval is given", None)
    if times is not None:
        expect(times.shape == q.shape[:2], f"{name}: times", q.shape[:2], times.shape)
        rising = bool((np.diff(times) > 0).all())
        expect(rising, f"{name}: times", "seconds that increase", times[0, :5])
    mass, coupling = found.mass, found.coupling
    bodies = (q.shape[0], q.shape[2])
    if mass is not None:
        expect(mass.shape == bodies, f"{name}: mass", bodies, mass.shape)
    if coupling is not None:
        expect(coupling.shape == q.shape[:1], f"{name}: coupling", q.shape[:1], coupling.shape)


def _check_clip(made: ClipFormat, name: str, path: Path) -> None:
    rate, count, frames = made.read(path)
    expect(rate >= 0 and count >= 0, name, "a rate and a count, 0 where unknown", (rate, count))
    read = list(frames)
    expect(len(read) >= 2, name, "two frames or more", len(read))
    first = read[0][0]
    for frame, _ in read:
        good = frame.dtype == np.uint8 and frame.shape == first.shape and frame.shape[2:] == (3,)
        expect(good, f"{name}: a frame", "bytes (H, W, 3), all of one size", frame.shape)
    seconds = np.array([stamp for _, stamp in read])
    expect(bool((np.diff(seconds) > 0).all()), f"{name}: times", "rising seconds", seconds[:5])
    again = [frame for frame, _ in made.read(path)[2]]
    same = all(np.array_equal(a, b) for (a, _), b in zip(read, again, strict=True))
    expect(same, name, "the same frames twice", "others")
