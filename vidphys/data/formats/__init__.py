"""File formats by name; a new one is one file and one line here."""

from vidphys.data.formats.animals import HDF5
from vidphys.data.formats.base import (
    FORMATS,
    ClipFormat,
    Format,
    Recording,
    TrackFormat,
    format_of,
    read_recording,
    read_table,
    sources_of,
    suffixes_of,
)
from vidphys.data.formats.c3d import read_c3d
from vidphys.data.formats.captured import is_captured, read_captured
from vidphys.data.formats.deeplabcut import is_deeplabcut, read_deeplabcut
from vidphys.data.formats.matlab import matlab_table, read_matlab
from vidphys.data.formats.opencv import read_clip
from vidphys.data.formats.sleap import is_sleap, read_sleap
from vidphys.data.formats.stacks import is_stack, read_stack
from vidphys.data.formats.structured import read_structured, structured_table
from vidphys.data.formats.tables import (
    arrays_table,
    parquet_table,
    read_array,
    read_arrays,
    read_parquet,
    read_text,
    read_workbook,
    text_table,
    workbook_table,
)
from vidphys.data.formats.tapvid import is_tapvid, points_table, read_tapvid
from vidphys.data.formats.text import holds_numbers, is_table
from vidphys.data.formats.tracker import is_project, read_marks, read_project

FILMS = (".mp4", ".avi", ".mkv", ".mov", ".ogv", ".webm", ".m4v")
OLD_FILMS = (".gif", ".mpg", ".mpeg", ".wmv", ".flv", ".3gp", ".ts", ".mts", ".m2ts")
RAW_FILMS = (".y4m", ".h264", ".hevc")
VIDEO = ClipFormat((*FILMS, *OLD_FILMS, *RAW_FILMS), read_clip, package="opencv-python-headless")
STACKS = (".tif", ".tiff", ".webp", ".png", ".apng")
TEXTS = (".txt", ".dat", ".tab", ".asc")  # where they hold numbers
CAPTURED = TrackFormat((".trc", ".tsv", ".csv", ".txt"), read_captured, is_captured)
FORMATS.register("captured", CAPTURED)
DEEPLABCUT = TrackFormat((".csv",), read_deeplabcut, is_deeplabcut, table=text_table)
FORMATS.register("deeplabcut", DEEPLABCUT)
FORMATS.register("deeplabcut hdf5", TrackFormat(HDF5, read_deeplabcut, is_deeplabcut))
FORMATS.register("csv", TrackFormat((".csv", ".tsv"), read_text, table=text_table))
BOOKS = (".xlsx", ".xlsm", ".xls", ".ods")
FORMATS.register("workbook", TrackFormat(BOOKS, read_workbook, table=workbook_table))
FORMATS.register("parquet", TrackFormat((".parquet",), read_parquet, table=parquet_table))
JSONS = (".json", ".jsonl", ".ndjson")
FORMATS.register("json", TrackFormat(JSONS, read_structured, table=structured_table))
FORMATS.register("tapvid", TrackFormat((".npz",), read_tapvid, is_tapvid, table=points_table))
FORMATS.register("npz", TrackFormat((".npz",), read_arrays, table=arrays_table))
FORMATS.register("npy", TrackFormat((".npy",), read_array))
FORMATS.register("text", TrackFormat(TEXTS, read_text, holds_numbers, table=text_table))
FORMATS.register("matlab", TrackFormat((".mat",), read_matlab, table=matlab_table))
TRACKER = TrackFormat((".trk", ".trz", ".zip"), read_project, is_project, read_marks)
FORMATS.register("tracker", TRACKER)
FORMATS.register("c3d", TrackFormat((".c3d",), read_c3d))
FORMATS.register("sleap", TrackFormat(HDF5, read_sleap, is_sleap))
FORMATS.register("multipage", ClipFormat(STACKS, read_stack, is_stack, package="pillow"))
FORMATS.register("video", VIDEO)
FORMATS.register("any text", TrackFormat((), read_text, is_table, table=text_table))

__all__ = [
    "FORMATS",
    "VIDEO",
    "ClipFormat",
    "Format",
    "Recording",
    "TrackFormat",
    "format_of",
    "read_recording",
    "read_table",
    "sources_of",
    "suffixes_of",
]
