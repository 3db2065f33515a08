"""File formats by name; a new one is one file and one line here."""

from vidphys.data.formats.base import (
    FORMATS,
    ClipFormat,
    Format,
    Recording,
    TrackFormat,
    format_of,
    read_recording,
    sources_of,
    suffixes_of,
)
from vidphys.data.formats.matlab import read_matlab
from vidphys.data.formats.opencv import read_clip
from vidphys.data.formats.structured import read_structured
from vidphys.data.formats.tables import read_arrays, read_parquet, read_text
from vidphys.data.formats.tapvid import is_tapvid, read_tapvid
from vidphys.data.formats.text import holds_numbers
from vidphys.data.formats.tracker import is_project, read_marks, read_project

VIDEO = ClipFormat((".mp4", ".avi", ".mkv", ".mov", ".ogv", ".webm", ".m4v"), read_clip)
FORMATS.register("csv", TrackFormat((".csv", ".tsv"), read_text))
FORMATS.register("parquet", TrackFormat((".parquet",), read_parquet))
FORMATS.register("json", TrackFormat((".json",), read_structured))
FORMATS.register("tapvid", TrackFormat((".npz",), read_tapvid, is_tapvid))
FORMATS.register("npz", TrackFormat((".npz",), read_arrays))
FORMATS.register("text", TrackFormat((".txt", ".dat", ".tab", ".asc"), read_text, holds_numbers))
FORMATS.register("matlab", TrackFormat((".mat",), read_matlab))
TRACKER = TrackFormat((".trk", ".trz", ".zip"), read_project, is_project, read_marks)
FORMATS.register("tracker", TRACKER)
FORMATS.register("video", VIDEO)

__all__ = [
    "FORMATS",
    "VIDEO",
    "ClipFormat",
    "Format",
    "Recording",
    "TrackFormat",
    "format_of",
    "read_recording",
    "sources_of",
    "suffixes_of",
]
