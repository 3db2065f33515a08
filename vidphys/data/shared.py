"""Clips to features by many workers at once, who know of each other by the store's folder alone.

Every worker slices what it was given into the same units. It claims one that nobody works on, makes
a part of the store of it, and puts that into its place whole; when all parts are there, one of the
workers joins them under an index, and only then are they read. So each clip counts once, whoever
dies: work of a dead worker is made anew by another, after its lease.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from encoders.parts import Part, join
from encoders.placing import partial_of, place, sweep
from encoders.shards import SPENT
from encoders.store import FeatureStore
from vidphys.data.ahead import ahead
from vidphys.data.many import Wanted, extract_many
from vidphys.data.units import Units, write_units
from vidphys.data.video import Video
from vidphys.runs.claims import LEASE, Claim, ClaimLost, Claims
from vidphys.runs.sealed import read_sealed, write_sealed

UNITS = "units.jsonl"
WORK = "work"  # claims, and parts that are not whole; gone at the end
ABOUT = "about.json"
SCHEMA, SAID = 1, ("clips", "entries", "failed")  # of it


@dataclass(frozen=True)
class Outcome:
    """What all workers did together, and this one of it.

    Args:
        units: how many there are.
        here: units that this worker made.
        clips: of all units.
        entries: that were not in the store before.
        failed: clips that could not be taken, each with the reason.
    """

    units: int
    here: int
    clips: int
    entries: int
    failed: tuple[tuple[str, str], ...]


class Extraction:
    """What workers do together.

    Args:
        store: theirs.
        given: see :func:`vidphys.data.listed.listed_clips`; the same for all workers.
        wanted: of each clip; the same for all workers. Its ``store`` is not used.
        selection: how clips are opened, for the name that the work goes by.

    Raises:
        InputError: nothing is there, or nothing in it is a clip.
    """

    def __init__(
        self, store: FeatureStore, given: Sequence[Path], wanted: Wanted, selection: Any
    ) -> None:
        self.store, self.wanted = store, wanted
        self.folder = _planned(store.shards.folder, given, _about(wanted, selection))
        self.units = Units(self.folder / UNITS)

    @property
    def joined(self) -> bool:
        """Whether all is done."""
        return self.folder.with_name(f"{self.folder.name}.sqlite").is_file()

    def part(self, unit: int) -> Path:
        """Where the result of a unit lies once it is whole."""
        return self.folder / f"{unit:06d}"

    def run(
        self,
        opened: Callable[[Path], Video],
        told: Callable[[int], None] = lambda unit: None,
        lease: float = LEASE,
    ) -> Outcome:
        """Take part until all units are done and joined.

        Args:
            opened: opens a clip.
            told: called with each unit that this worker has made.
            lease: see :class:`vidphys.runs.claims.Claims`.
        """
        here = 0
        if not self.joined:
            with Claims(self.folder / WORK, lease) as claims:
                for claim in claims.each(range(len(self.units)), self._is_done):
                    try:
                        made = self._make(claim, claims.worker, opened)
                    except (ClaimLost, FileNotFoundError):
                        if claim.held() and not self._is_done(claim.unit):
                            raise
                        continue  # others are done with it, and have tidied up perhaps
                    if made:
                        here += 1
                        told(claim.unit)
                for claim in claims.each([len(self.units)], lambda _: self.joined):
                    with suppress(ClaimLost):
                        self._join(claim, claims.worker)
        shutil.rmtree(self.folder / WORK, ignore_errors=True)
        about = self._said()
        failed = tuple((path, why) for path, why in about["failed"])
        return Outcome(len(self.units), here, about["clips"], about["entries"], failed)

    def first(self, opened: Callable[[Path], Video]) -> Video | None:
        """The first clip that can be opened, which is the same for all workers."""
        for unit in range(len(self.units)):
            with suppress(ValueError):
                for clip in self.units[unit]:
                    if isinstance(found := _tried(opened, clip), Video):
                        return found
        return None

    def _said(self) -> dict[str, Any]:
        path = self.folder / ABOUT
        todo = f"move {self.folder}.sqlite away, and extract again"
        return read_sealed(path, "what a shared extraction did", todo, SCHEMA, (*SAID,))

    def _is_done(self, unit: int) -> bool:
        return self.part(unit).is_dir() or self.joined

    def _make(self, claim: Claim, worker: str, opened: Callable[[Path], Video]) -> bool:
        scratch = self.folder / WORK / f"{worker}-{claim.unit}-{claim.take}"
        with Part(self.store, scratch) as part:
            try:
                clips = self.units[claim.unit]
            except ValueError as error:
                clips, failed = [], [(f"unit {claim.unit}", str(error))]
            else:
                failed = _extracted(clips, replace(self.wanted, store=part), opened, claim)
            claim.require()
            about = {"clips": len(clips), "entries": len(part), "failed": failed}
            return part.commit(self.part(claim.unit), about)

    def _join(self, claim: Claim, worker: str) -> None:
        scratch = self.folder / WORK / f"{worker}-{claim.take}.sqlite"
        clips, entries, failed = 0, 0, []
        for number, about in enumerate(join(self.folder, len(self.units), scratch), 1):
            claim.require()
            clips, entries = clips + about["clips"], entries + about["entries"]
            failed += about["failed"]
            if number == len(self.units):  # before the index, which says that all is done
                said = {"clips": clips, "entries": entries, "failed": failed}
                beside = scratch.with_suffix(".json")
                write_sealed(beside, said, SCHEMA)
                place({beside: self.folder / ABOUT})


def _planned(shards: Path, given: Sequence[Path], about: Any) -> Path:
    """The folder of the work, with its units; the same for every worker."""
    units = partial_of(shards / UNITS)
    sweep(shards)
    try:
        name = f"shared-{write_units(given, about, units)[:16]}"
        again = 0
        while (shards / f"{name}-{again}" / SPENT).exists():
            again += 1  # something was taken out of it, to be made again
        folder = shards / f"{name}-{again}"
        folder.mkdir(exist_ok=True)
        units.replace(folder / UNITS)
    finally:
        units.unlink(missing_ok=True)
    return folder


def _about(wanted: Wanted, selection: Any) -> Any:
    identities = [asdict(wanted.encoder.at(layer).identity) for layer in wanted.layers]
    grid = {} if wanted.grid is None else {"grid": wanted.grid}
    return {"encoder": identities, "dtype": wanted.dtype, **grid, "selection": selection}


def _extracted(
    clips: Sequence[Path], wanted: Wanted, opened: Callable[[Path], Video], claim: Claim
) -> list[tuple[str, str]]:
    """Extract the clips of a unit; those that cannot be taken, each with the reason."""
    failed: dict[Path, str] = {}
    done: list[Path] = []  # hashed only where something went wrong

    def coming(some: Sequence[Path]) -> Iterator[Video]:
        tried = ahead([partial(_tried, opened, clip) for clip in some])
        for clip, found in zip(some, tried, strict=True):
            claim.require()
            if isinstance(found, Video):
                yield found
            else:
                failed[clip] = str(found)

    def kept(video: Video, _layers: Sequence[str]) -> None:
        done.append(video.path)

    try:
        extract_many(coming(clips), wanted, kept)
    except ValueError:  # frames or features of one of the clips that share a pass
        over = {*done, *failed}
        for clip in clips:
            if clip not in over:
                try:
                    extract_many(coming([clip]), wanted, kept)
                except ValueError as error:
                    failed[clip] = str(error)
    return [(str(clip), why) for clip, why in failed.items()]


def _tried(opened: Callable[[Path], Video], clip: Path) -> Video | ValueError:
    try:
        return opened(clip)
    except ValueError as error:
        return error
