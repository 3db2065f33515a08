"""Z4, Z7, Z10: JSON of strangers is closed, typed, bounded and not deep; the field is named."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from dynamics import terms
from vidphys import boundary
from vidphys.boundary import Closed, read_json
from vidphys.cli import main
from vidphys.data.dataset import find_dataset
from vidphys.data.sets.folder import read_manifest
from vidphys.diagnose.explanations.specification import as_specification, read_specification
from vidphys.errors import InputError
from vidphys.experiments.filmed.truth import Truth

pytestmark = pytest.mark.usefixtures("unchecked")
TRAP = terms.Hamiltonian(
    potentials=(terms.Trap(4.0), terms.Uniform((0.0, -9.0))), ports=(terms.Drag(rate=0.1),)
)
GOOD = as_specification(TRAP, 1, (0.0, 0.0), {"trap: k": (4.0, 0.1)}, True, 0.04)
LEGACY = {"kind": "hamiltonian", "potential": "displacement"}


def changed(held: dict, where: str, value: object) -> dict:
    """A copy in which one field, however deep, is another."""
    copy = json.loads(json.dumps(held))
    *before, last = (int(key) if key.isdigit() else key for key in where.split("/"))
    part = copy
    for key in before:
        part = part[key]
    part[last] = value
    return copy


def refused(tmp_path: Path, text: str | bytes, said: str) -> None:
    path = tmp_path / "s.json"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError) as caught:
        read_specification(path)
    assert said in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_z04_what_we_write_is_read(tmp_path):
    (tmp_path / "s.json").write_text(json.dumps(GOOD))
    term, held = read_specification(tmp_path / "s.json")
    assert term == TRAP
    assert held["numbers"]["trap: k"] == {"value": 4.0, "standard_error": 0.1}


@pytest.mark.parametrize(
    ("where", "value", "said"),
    [
        ("bodies", 0, "bodies 0: "),
        ("bodies", 10**9, "bodies 1000000000: "),
        ("bodies", "1", "bodies '1': "),
        ("space", 4, "space 4: "),
        ("interval_seconds", 0.0, "interval_seconds 0.0: "),
        ("interval_seconds", float("nan"), "interval_seconds nan: "),
        ("interval_seconds", float("inf"), "interval_seconds inf: "),
        ("origin", [0.0], "origin: has 1 numbers and needs 2"),
        ("origin/0", 1e300, "origin.0 1e+300: "),
        ("mass", [1.0, 1.0], "mass: has 2 numbers and needs 1"),
        ("mass", [-1.0], "mass.0 -1.0: "),
        ("numbers", {"a": {"value": 1.0}}, "numbers.a.standard_error: Field required"),
        ("schema_version", 2, "schema_version 2: "),
        ("explained", 1, "explained 1: "),
        ("_target_", "os.system", "_target_ 'os.system': Extra inputs are not permitted"),
        ("terms/potentials/0/stiffness", -5.0, "trap: stiffness -5.0: must be above 0"),
        ("terms/potentials/0/stiffness", float("nan"), "trap: stiffness nan: "),
        ("terms/potentials/0/stiffness", "4", "trap: stiffness '4': "),
        ("terms/potentials/0/learned", "yes", "trap: learned 'yes': "),
        ("terms/potentials/0/centre", [1.0, 2.0, 3.0], "centre"),
        ("terms/potentials/0/term", "os.system", "unknown term 'os.system'"),
        ("terms/potentials/0/term", ["trap"], "terms that make no model"),
        ("terms/potentials/0/stifness", 4.0, "did you mean 'stiffness'?"),
        ("terms/potentials", [{"term": "radial"}] * 1000, "more than 256 terms"),
        ("terms/potentials", [{"term": "radial", "width": 10**7}], "radial: width 10000000: "),
        ("terms/ports/0/law", "cubed", "cubed"),
        ("terms/ports/0/rate", 1e200, "drag: rate 1e+200: "),
        ("terms", {"term": "trap", "stiffness": 1.0}, "no model of a whole scene"),
        ("terms", {**LEGACY, "sources": ["mass"] * 1000}, "more than 256 terms"),
        ("terms", {**LEGACY, "ports": [3]}, "terms that make no model"),
        ("terms", {**LEGACY, "wall": [1]}, "terms that make no model"),
    ],
)
def test_z04_a_specification_is_bounded_and_the_field_is_named(tmp_path, where, value, said):
    refused(tmp_path, json.dumps(changed(GOOD, where, value)), said)


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"{",
        b"[]",
        b"null",
        b"\xff\xfe\x00",
        b'{"schema_version": 1}',
        b'{"a": ' * 100_000,
        b"[" * 1_000_000,
        b"9" * 100_000,
    ],
)
def test_z10_what_is_no_specification_or_deep_is_one_line(tmp_path, text):
    refused(tmp_path, text, "not a scene specification")


def test_z10_terms_that_are_deep_are_refused(tmp_path):
    deep: dict = {"term": "no-potential"}
    for _ in range(150):
        deep = {"term": "shortcut", "beside": [deep]}
    refused(tmp_path, json.dumps(changed(GOOD, "terms/potentials/0", deep)), "recursion limit")


def test_z09_a_large_file_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(boundary, "MAX_BYTES", 100)
    refused(tmp_path, json.dumps(GOOD), "not a scene specification")


def test_z10_what_is_no_file_is_not_waited_for(tmp_path):
    with pytest.raises(InputError, match="not a file"):
        read_json(tmp_path, Closed, "anything")
    with pytest.raises(InputError, match="cannot be read"):
        read_json(tmp_path / "none.json", Closed, "anything")


def test_z04_fit_says_the_field_in_one_line(tmp_path, capsys):
    (tmp_path / "s.json").write_text(json.dumps(changed(GOOD, "interval_seconds", float("nan"))))
    (tmp_path / "t.csv").write_text("t,x,y\n0,0,0\n1,1,1\n2,2,2\n")
    command = ["fit", str(tmp_path / "t.csv"), "--specification", str(tmp_path / "s.json")]
    assert main([*command, "--out", str(tmp_path / "run")]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "interval_seconds nan" in told
    assert not (tmp_path / "run").exists()


CLIPS = {"clips": [{"file": "a.mp4", "coupling": 1.0, "mass": [1.0]}], "half_extent": 2.0}


@pytest.mark.parametrize(
    ("where", "value", "said"),
    [
        ("half_extent", 0, "half_extent 0: "),
        ("half_extent", float("inf"), "half_extent inf: "),
        ("half_extent", "2", "half_extent '2': "),
        ("identical", "no", "identical 'no': "),
        ("clips", {}, "clips: "),
        ("clips/0/mass", [], "clips.0.mass: "),
        ("clips/0/mass", [float("nan")], "clips.0.mass.0 nan: "),
        ("clips/0/masss", [1.0], "clips.0.masss: Extra inputs"),
        ("clips/0/coupling", None, "clips.0.coupling: "),
        ("clips/0/sha256", "abc", "clips.0.sha256 'abc': "),
        ("schema_version", 2, "schema_version 2: "),
        ("extra", 1, "extra 1: Extra inputs are not permitted"),
        ("clips/0/file", "../a.mp4", "'../a.mp4', which is not in its folder"),
        ("clips/0/file", "b/../../a.mp4", "which is not in its folder"),
        ("clips/0/file", "/etc/passwd", "which is not in its folder"),
        ("clips/0/file", "C:a.mp4", "which is not in its folder"),
        ("clips/0/file", "..\\a.mp4", "which is not in its folder"),
        ("clips/0/file", "\\\\host\\a.mp4", "which is not in its folder"),
        ("clips/0/file", "a\0.mp4", "is no name of a file"),
        ("clips/0/file", " ", "is no name of a file"),
        ("clips/0/file", "out.mp4", "which is not in its folder"),
        ("clips/0/file", "beside.mp4", "which is not in its folder"),
        ("clips/0/file", "b/a.mp4", "which is not there"),
    ],
)
def test_z07_a_list_of_clips_is_bounded_and_stays_in_its_folder(tmp_path, where, value, said):
    folder = tmp_path / "data"
    folder.mkdir()
    (folder / "a.mp4").write_bytes(b"a")
    (tmp_path / "a.mp4").write_bytes(b"a")
    (folder / "out.mp4").symlink_to(tmp_path / "a.mp4")
    (tmp_path / "secret.csv").write_text("u1,v1\n1,2\n")
    (folder / "beside.mp4").write_bytes(b"a")
    (folder / "beside.csv").symlink_to(tmp_path / "secret.csv")
    (folder / "dataset.json").write_text(json.dumps(CLIPS))
    assert find_dataset(folder).files[0].mass == (1.0,)
    (folder / "dataset.json").write_text(json.dumps(changed(CLIPS, where, value)))
    with pytest.raises(InputError) as caught:
        read_manifest(folder / "dataset.json")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


TRUTH = {
    "schema_version": 1,
    "kind": "fall",
    "part": "tune",
    "seed": 0,
    "number": 0,
    "size": [4, 6],
    "structure": ["uniform"],
    "numbers": [{"name": "g", "value": 9.8, "unit": "m/s2", "body": None}],
    "stamps": [0.0, 0.1],
    "times": [0.0, 0.1],
    "shown": [0, 1],
    "pixels": [[[1.0, 2.0]], [[1.0, 3.0]]],
    "steady": [[[1.0, 2.0]], [[1.0, 3.0]]],
    "radii": [1.0],
    "metres": [[[0.1, 0.2]], [[0.1, 0.3]]],
    "released": 0.0,
    "ruler": {"metres": 1.0, "pixels": [[0.0, 0.0], [1.0, 1.0]]},
    "view": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    "values": {"g": 9.8},
    "nuisances": {"shake": 0.1},
}


@pytest.mark.parametrize(
    ("where", "value", "said"),
    [
        ("seed", -1, "seed -1: "),
        ("stamps", [0.0], "times: is of 2 frames, not 1"),
        ("pixels/0", [], "pixels: is not of 1 bodies in every frame"),
        ("pixels/1/0/0", float("nan"), "pixels.1.0.0 nan: "),
        ("ruler/metres", 0.0, "ruler.metres 0.0: "),
        ("view", [], "view"),
        ("numbers/0/value", "9.8", "numbers.0.value '9.8': "),
        ("more", 1, "more 1: Extra inputs"),
    ],
)
def test_z04_the_truth_of_a_clip_is_bounded(tmp_path, where, value, said):
    path = tmp_path / "truth.json"
    path.write_text(json.dumps(TRUTH))
    assert Truth.read(path).pixels.shape == (2, 1, 2)
    path.write_text(json.dumps(changed(TRUTH, where, value)))
    with pytest.raises(InputError) as caught:
        Truth.read(path)
    assert said in str(caught.value)
