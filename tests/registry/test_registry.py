"""Names to parts: ours, by entry point, by import path, and what an unknown one is told."""

from __future__ import annotations

import importlib.metadata

import pytest

from registry import Registry, Source, UnknownName


@pytest.fixture
def shapes() -> Registry:
    found: Registry = Registry("shape", "example.shapes")
    found.register("disk", object())
    return found


def installed(monkeypatch: pytest.MonkeyPatch, *pairs: tuple[str, str]) -> None:
    """Entry points ``(name, value)`` of the group, as if pytest's distribution had them."""
    dist = importlib.metadata.distribution("pytest")
    points = []
    for name, value in pairs:
        point = importlib.metadata.EntryPoint(name, value, "example.shapes")
        points.append(point._for(dist))  # type: ignore[attr-defined]

    def entry_points(**chosen: str):
        known = importlib.metadata.EntryPoints(points)
        return known.select(**chosen)

    monkeypatch.setattr(importlib.metadata, "entry_points", entry_points)


def test_a_name_that_is_taken_is_refused(shapes):
    with pytest.raises(ValueError, match="would replace the one of tests"):
        shapes.register("disk", object())


def test_an_unknown_name_says_what_there_is(shapes):
    with pytest.raises(UnknownName, match="unknown shape 'dis'; did you mean 'disk'. Known: disk"):
        shapes["dis"]
    assert "dis" not in shapes
    assert shapes.get("dis") is None


def test_an_import_path_is_a_name(shapes):
    assert shapes["pathlib:Path.cwd"]() is not None
    assert not {"pathlib:Path.cwd"} & {*shapes.foreign(), *shapes.ours()}
    with pytest.raises(ValueError, match="shape 'pathlib:Pat': .* cannot be imported"):
        shapes["pathlib:Pat"]
    with pytest.raises(ValueError, match="No module named 'no_such_module'"):
        shapes["no_such_module:x"]


def test_an_installed_package_adds_a_part(shapes, monkeypatch):
    installed(monkeypatch, ("square", "pathlib:Path"))
    assert list(shapes) == ["disk", "square"]
    assert shapes.source("square") == Source("pytest", importlib.metadata.version("pytest"))
    assert shapes["square"].__name__ == "Path"
    assert "square" in shapes.foreign()


def test_two_givers_of_one_name_are_both_named(shapes, monkeypatch):
    installed(monkeypatch, ("disk", "pathlib:Path"))
    with pytest.raises(ValueError, match=r"shape 'disk': given by .*pytest.* uninstall one"):
        shapes["disk"]


def test_our_own_parts_are_known_without_a_look_at_every_distribution(monkeypatch):
    def slow():
        raise AssertionError("every distribution was looked at")

    monkeypatch.setattr(importlib.metadata, "packages_distributions", slow)
    found: Registry = Registry("shape", "example.shapes")
    assert found.source("registry:Registry") == Source(
        "vidphys", importlib.metadata.version("vidphys")
    )
    assert found.sources("registry:Registry") == {}
