"""The table of labels that lies beside a clip: a file of its name, of any format of tracks."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

from vidphys.data.formats import TrackFormat, format_of, suffixes_of
from vidphys.errors import InputError

UNREAD = {
    **dict.fromkeys((".feather", ".arrow", ".orc"), "save it as Parquet"),
    **dict.fromkeys((".npy", ".pt", ".h5", ".hdf5"), "save its arrays as NPZ"),
    **dict.fromkeys((".pkl", ".pickle"), "a pickle can run any code; save its arrays as NPZ"),
}


class Beside:
    """What lies beside clips; each folder is listed once."""

    def __init__(self) -> None:
        self._files: dict[Path, dict[str, list[Path]]] = {}

    def labels(self, clip: Path) -> Path | None:
        """The file of labels of a clip, if there is one.

        Raises:
            InputError: there are two, or one that looks like a table and cannot be read.
        """
        known, found = suffixes_of(TrackFormat), []
        for path in self._named(clip):
            suffix = path.suffix.lower()
            if suffix in UNREAD:
                raise InputError(
                    f"{clip}: {path.name} beside it would not be used: {UNREAD[suffix]}, or give "
                    "it another name"
                )
            if suffix in known and path.is_file() and format_of(path, TrackFormat) is not None:
                found.append(path)
        if len(found) > 1:
            names = f"{found[0].name} and {found[1].name}"
            raise InputError(f"{clip}: has two files of labels, {names}; keep one")
        return found[0] if found else None

    def _named(self, clip: Path) -> list[Path]:
        """Files of the clip's name, in the order of their own."""
        folder = clip.parent
        if folder not in self._files:
            listed: dict[str, list[Path]] = defaultdict(list)
            for path in sorted(folder.iterdir()):
                listed[path.stem].append(path)
            self._files[folder] = listed
        return [path for path in self._files[folder].get(clip.stem, ()) if path != clip]
