"""F3: damaged shards, indexes, and what workers that share an extraction tell each other."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest
import torch

from encoders.entry import Origin
from encoders.features import streamed
from encoders.parts import MANIFEST, Part, join, read_part
from encoders.shards import ENTRIES
from encoders.store import FeatureStore, StaleFeatures
from tests.faults.test_read_back import undetected
from tests.shared.stored import TIMES, fill, made, request
from vidphys.data.shared import ABOUT, SCHEMA, Extraction
from vidphys.data.units import Units, write_units
from vidphys.errors import InputError
from vidphys.runs.claims import Claims
from vidphys.runs.sealed import write_sealed

ENTRIES_OF = 4


def packed(folder: Path) -> dict[str, Path]:
    fill(folder, range(ENTRIES_OF)).pack()
    shards = folder / "shards"
    return {"index": shards / "index.sqlite", "entries": shards / "000000.bin"}


def shared(folder: Path) -> dict[str, Path]:
    """A store of one part, under an index that is never changed."""
    store, parts = FeatureStore(folder), folder / "shards" / "shared-0"
    parts.mkdir(parents=True)
    with Part(store, folder / "work") as part:
        for number in range(ENTRIES_OF):
            asked, stream = request(number), streamed("8", made(number))
            origin = Origin("clip.mp4", stream.size, stream.times)
            with part.begin([asked], origin) as entries:
                for piece in stream.pieces:
                    entries.add(piece)
        assert part.commit(parts / "000000", {"clips": ENTRIES_OF, "failed": []})
    assert len([*join(parts, 1, folder / "scratch.sqlite")]) == 1
    return {
        "index": parts.with_name("shared-0.sqlite"),
        "entries": parts / "000000" / ENTRIES,
        "manifest": parts / "000000" / MANIFEST,
    }


@pytest.mark.parametrize("laid", [packed, shared])
@pytest.mark.parametrize("file", ["index", "entries"])
def test_f3_no_damaged_shard_and_no_row_of_a_damaged_index_is_used(tmp_path, laid, file):
    """An entry that a damaged index does not find is made again."""
    path = laid(tmp_path)[file]
    wanted = made(1)

    def read():
        store = FeatureStore(tmp_path)
        store.has(request(1))
        return store.read(request(1)), store.shape_of(request(1))

    def same(found) -> bool:
        features, shape = found
        return features is None or (
            torch.equal(features.values, wanted.values)
            and torch.equal(features.times, TIMES)
            and features.stride == wanted.stride
            and shape == tuple(wanted.values[0].shape)
        )

    assert undetected(path, read, same, StaleFeatures) == []
    features, _ = read()
    assert features is not None


def test_f3_no_damaged_manifest_of_a_part_is_joined(tmp_path):
    path = shared(tmp_path)["manifest"]
    whole = read_part(path.parent)
    assert undetected(path, lambda: read_part(path.parent), whole.__eq__, StaleFeatures) == []
    assert read_part(path.parent) == whole


def test_parts_of_the_version_before_are_joined_into_the_same_index(tmp_path):
    paths = shared(tmp_path)
    part, index = paths["manifest"].parent, paths["index"].read_bytes()
    about, rows = read_part(part)
    lines = "".join(json.dumps(row) + "\n" for row in rows)
    said = json.dumps(about, sort_keys=True) + "\n" + lines
    head = {
        "schema_version": 2,
        "about": about,
        "sha256": hashlib.sha256(said.encode()).hexdigest(),
    }
    paths["manifest"].write_text(json.dumps(head) + "\n" + lines)
    paths["index"].unlink()
    assert [*join(part.parent, 1, tmp_path / "scratch.sqlite")] == [about]
    assert paths["index"].read_bytes() == index


def test_a_part_without_an_entry_says_why(tmp_path):
    with Part(FeatureStore(tmp_path), tmp_path / "work") as part:
        assert part.commit(tmp_path / "000000", {"failed": [["a.avi", "empty"]]})
    assert read_part(tmp_path / "000000") == ({"failed": [["a.avi", "empty"]]}, [])


def test_f3_what_a_shared_extraction_did_is_told_as_it_was_or_not_at_all(tmp_path):
    path = tmp_path / "shared-0" / ABOUT
    path.parent.mkdir()
    write_sealed(path, {"clips": 3, "entries": 6, "failed": [["a.avi", "empty"]]}, SCHEMA)
    work = Extraction.__new__(Extraction)
    work.folder = path.parent
    whole = work._said()
    assert undetected(path, work._said, whole.__eq__, InputError) == []


def test_f3_a_list_of_units_that_is_damaged_while_it_is_worked_through_is_seen(tmp_path):
    for name in ("a.avi", "b.avi"):
        (tmp_path / name).touch()
    path = tmp_path / "units.jsonl"
    write_units([tmp_path], {}, path)
    units = Units(path)
    whole = units[0]
    assert [clip.name for clip in whole] == ["a.avi", "b.avi"]
    assert undetected(path, lambda: units[0], whole.__eq__, OSError) == []


def test_f3_a_damaged_claim_is_watched_or_taken_over_and_never_stops_anybody(tmp_path):
    with Claims(tmp_path, 60.0) as first, Claims(tmp_path, 60.0) as second:
        assert first.take(0) is not None
        path = tmp_path / "claims" / "000000.1"
        odd = [b'{"worker": "\\u0000", "lease": 1}', b'{"worker": 1, "lease": "x"}', b"[1]"]
        for content in odd:
            path.write_bytes(content)
            assert second.take(0) is None

        def read() -> str:
            second.take(0)
            for later in (tmp_path / "claims").glob("000000.[!1]*"):
                later.unlink()
            return "went on"

        path.write_text(json.dumps({"worker": first.worker, "lease": 60.0, "pid": 1}))
        assert undetected(path, read, "went on".__eq__, InputError) == []
