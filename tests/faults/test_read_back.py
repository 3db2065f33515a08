"""F3, Z7: what is read back is what was written, or its file is named."""

from __future__ import annotations

import json
import os
import random
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import torch

from binders import Detections
from encoders.features import FeatureMap
from encoders.identity import EncoderIdentity
from encoders.store import FeatureRequest, FeatureStore, StaleFeatures
from renderers import WORLDS, Camera
from tests.shared.stored import as_older, parts_of, put_together
from vidphys.data.clips import render_clips
from vidphys.data.dataset import find_dataset
from vidphys.data.rendered import RenderSettings, render_folder
from vidphys.errors import InputError
from vidphys.experiments.core.showcase import keep_showcase
from vidphys.experiments.pixels.seen import pixel_scene
from vidphys.perception.detections import detections_of
from vidphys.runs.folder import RunFolder
from vidphys.runs.records import read_table, write_table
from vidphys.runs.sealed import write_sealed
from vidphys.stress import matrix
from vidphys.stress.matrix import PRESETS as STRESS
from vidphys.stress.matrix import families, load_family
from vidphys.stress.verdict import Outcome
from viz.showcase import ROLES, read_showcase

COUNT = 800 if os.environ.get("VIDPHYS_FAULTS") else 150  # flips of each file; `make faults`
IDENTITY = EncoderIdentity("mine", 1, "0" * 64, "none", "last", 32, "float32")
REQUEST = FeatureRequest(IDENTITY, "1" * 64, (0, 1), (0.0, 0.1), (32, 32))
MADE = FeatureMap(torch.rand(1, 2, 8, 2, 2).half().float(), (16.0, 16.0), torch.tensor([0.0, 0.1]))
SETTINGS = {"cells": [], "seeds": []}


def mutants(whole: bytes, count: int) -> list[bytes]:
    """Flips at places spread over the file, and files cut short."""
    rng, made = random.Random(0), []
    for number in range(count):
        place = number * len(whole) // count
        made.append(
            whole[:place] + bytes([whole[place] ^ 1 << rng.randrange(8)]) + whole[place + 1 :]
        )
    return made + [whole[: number * len(whole) // 8] for number in range(8)]


def undetected(path: Path, read: Callable[[], object], same: Callable, error: type) -> list[int]:
    """The mutants of a file that are used for something else than was written."""
    whole, silent = path.read_bytes(), []
    for number, content in enumerate(mutants(whole, COUNT)):
        path.write_bytes(content)
        try:
            found = read()
        except error as said:
            assert path.name[:12] in str(said)
            assert "\n" not in str(said)
        else:
            if not same(found):
                silent.append(number)
    path.write_bytes(whole)
    return silent


@pytest.mark.parametrize("suffix", [".entry", ".json", ".safetensors"])
def test_f3_no_damaged_entry_of_a_feature_store_is_used(tmp_path, suffix):
    FeatureStore(tmp_path).write(REQUEST, "clip.mp4", MADE)
    if suffix != ".entry":
        as_older(tmp_path)
    kept = (tmp_path / "entries" / REQUEST.key).with_suffix(suffix)

    def read() -> FeatureMap:
        found = FeatureStore(tmp_path).read(REQUEST)
        assert found is not None
        return found

    def same(found: FeatureMap) -> bool:
        return torch.equal(found.values.float(), MADE.values) and found.stride == MADE.stride

    assert undetected(kept, read, same, StaleFeatures) == []
    assert same(read())


def test_f3_an_entry_that_changes_under_an_open_store_is_seen(tmp_path):
    store = FeatureStore(tmp_path)
    store.write(REQUEST, "clip.mp4", MADE)
    store.read(REQUEST)
    kept = tmp_path / "entries" / f"{REQUEST.key}.entry"
    tensors, said = parts_of(kept)
    put_together(kept, tensors[:-1] + bytes([tensors[-1] ^ 1]), said)
    with pytest.raises(StaleFeatures, match="is damaged"):
        store.read(REQUEST)


def test_f1_what_killed_processes_left_in_a_store_is_swept_and_what_others_write_is_not(tmp_path):
    entries = tmp_path / "entries"
    entries.mkdir()
    old = (".a.json.1.partial", "c.safetensors", "d.safetensors", "d.json")
    for name, age in (
        (".b.json.2.partial", 0.0),
        ("e.safetensors", 0.0),
        *((n, 7200.0) for n in old),
    ):
        (entries / name).write_text("half")
        os.utime(entries / name, (time.time() - age,) * 2)
    FeatureStore(tmp_path).write(REQUEST, "clip.mp4", MADE)
    kept = {".b.json.2.partial", "e.safetensors", "d.safetensors", "d.json"}
    assert {path.name for path in entries.glob("*")} == {*kept, f"{REQUEST.key}.entry"}


def test_f12_an_entry_of_before_manifests_were_sealed_is_read(tmp_path):
    FeatureStore(tmp_path).write(REQUEST, "clip.mp4", MADE)
    as_older(tmp_path)
    kept = tmp_path / "entries" / f"{REQUEST.key}.json"
    manifest = json.loads(kept.read_text())
    del manifest["seal"]
    with pytest.raises(StaleFeatures, match="damaged or was edited"):
        kept.write_text(json.dumps(manifest))
        FeatureStore(tmp_path).read(REQUEST)
    kept.write_text(json.dumps({**manifest, "schema_version": 1}))
    assert FeatureStore(tmp_path).read(REQUEST) is not None


def test_f3_no_damaged_table_of_a_run_is_joined(tmp_path):
    table = pa.table(
        {"name": ["a", "b", None], "value": [0.5, None, float("nan")], "seed": [0, 1, 2]}
    )
    path = tmp_path / "records-a.parquet"
    write_table(path, table.replace_schema_metadata({b"made_by": b"x"}))
    rows = str(table.to_pylist())

    def same(found: pa.Table) -> bool:
        return str(found.to_pylist()) == rows

    assert undetected(path, lambda: read_table(path), same, InputError) == []
    assert same(read_table(path))
    assert read_table(path).schema.metadata == {b"made_by": b"x"}


def shown(path: Path) -> dict[str, np.ndarray]:
    """A showcase as a cell leaves it."""
    times = torch.linspace(0, 1, 5, dtype=torch.float64)
    arrays = {"times": times, "half_extent": torch.tensor(4.0, dtype=torch.float64)}
    for role in ROLES:
        arrays[role] = torch.rand(5, 3, 2, dtype=torch.float64)
        arrays[f"energy_{role}"] = torch.rand(5)
    keep_showcase(path, arrays, {"cell": "oracle/factored", "seed": "0"})
    return {name: array.numpy() for name, array in arrays.items()}


def test_f3_no_damaged_showcase_is_drawn(tmp_path):
    path = tmp_path / "oracle-factored.safetensors"
    whole = shown(path)

    def same(found) -> bool:
        arrays, about = found
        return about == {"cell": "oracle/factored", "seed": "0"} and all(
            np.array_equal(arrays[name], whole[name]) for name in whole
        )

    assert undetected(path, lambda: read_showcase(path), same, ValueError) == []
    assert same(read_showcase(path))


def test_f3_no_damaged_outcome_of_stress_is_counted(tmp_path):
    run = RunFolder.open(tmp_path / "r", SETTINGS)
    name, cases = next(iter(families(STRESS["quick"]).items()))
    case = next(iter(cases))
    outcome = Outcome(case, "sound", 1e-9, "fine", 0.25)
    path = matrix._kept(run, name)
    write_sealed(path, {"cells": [matrix._plain(outcome)]}, matrix.SCHEMA_VERSION)

    def same(found) -> bool:
        return found == [outcome]

    def read():
        return load_family(run, name, [case])

    assert undetected(path, read, same, InputError) == []
    assert same(read())


def test_f3_no_damaged_run_json_is_gone_on_with(tmp_path):
    run = RunFolder.open(tmp_path / "r", SETTINGS)
    whole = run.manifest()
    assert undetected(run.manifest_path, run.manifest, whole.__eq__, InputError) == []


def test_f3_no_damaged_detections_are_used(tmp_path):
    clips = render_clips(
        pixel_scene(), WORLDS["anonymous"](camera=Camera(height=32, width=32)), 2, 3, 4, 0, "x"
    )
    made = Detections(torch.rand(2, 3, 3, 2), torch.rand(2, 3, 3), clips.times.float())

    def read() -> Detections:
        return detections_of(clips, tmp_path, lambda _: made)

    read()
    (path,) = tmp_path.glob("*.safetensors")

    def same(found: Detections) -> bool:
        return torch.equal(found.positions, made.positions)

    assert undetected(path, read, same, InputError) == []


@pytest.fixture(scope="module")
def rendered(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("rendered") / "run"
    settings = RenderSettings("gravity", "rgb", 2, 3, 2, 16, 0)
    render_folder(RunFolder.open(folder, SETTINGS), settings)
    return folder


@pytest.mark.parametrize("name", ["00001.avi", "00001.csv"])
def test_f3_a_clip_or_its_labels_that_the_list_does_not_know_are_not_trained_on(rendered, name):
    assert len(find_dataset(rendered).files) == 2
    file = rendered / "clips" / name
    whole = file.read_bytes()
    file.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    with pytest.raises(InputError, match=rf"{name}: not the file that .*dataset\.json lists"):
        find_dataset(rendered)
    file.write_bytes(whole)


@pytest.mark.parametrize("how", ["..", "absolute", "link"])
def test_z7_a_list_of_clips_stays_in_its_folder(tmp_path, how):
    folder, secret = tmp_path / "data", tmp_path / "secret.mp4"
    folder.mkdir()
    secret.write_bytes(b"x")
    (folder / "link.mp4").symlink_to(secret)
    file = {"..": "../secret.mp4", "absolute": str(secret), "link": "link.mp4"}[how]
    (folder / "dataset.json").write_text(json.dumps({"clips": [{"file": file}]}))
    with pytest.raises(InputError, match="which is not in its folder"):
        find_dataset(folder)
