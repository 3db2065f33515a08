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
from vidphys.data.formats.opencv import read_clip
from vidphys.data.formats.tables import is_text, read_arrays, read_csv, read_parquet, read_text

VIDEO = ClipFormat((".mp4", ".avi", ".mkv", ".mov", ".ogv", ".webm", ".m4v"), read_clip)
FORMATS.register("csv", TrackFormat((".csv",), read_csv))
FORMATS.register("parquet", TrackFormat((".parquet",), read_parquet))
FORMATS.register("npz", TrackFormat((".npz",), read_arrays))
FORMATS.register("text", TrackFormat((".txt",), read_text, is_text))
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
