"""Whose the installed files are: another distribution's `renderers` is noticed at the start."""

from __future__ import annotations

import base64
import hashlib
import importlib.metadata
from pathlib import Path

import pytest

from vidphys import cli
from vidphys.cli import main, owners

PACKAGES = ("renderers", "viz")


def installed(site: Path, name: str, packages: tuple[str, ...], top_level: bool = True) -> None:
    """A distribution as an installer leaves it."""
    about = site / f"{name}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    if top_level:
        (about / "top_level.txt").write_text("\n".join(packages))
    lines = []
    for package in packages:
        file = site / package / "__init__.py"
        file.parent.mkdir(exist_ok=True)
        file.write_text(f'"""Of {name}."""\n')
        digest = base64.urlsafe_b64encode(hashlib.sha256(file.read_bytes()).digest())
        lines.append(f"{package}/__init__.py,sha256={digest.rstrip(b'=').decode()},10")
    (about / "RECORD").write_text("\n".join([*lines, f"{about.name}/RECORD,,"]) + "\n")


@pytest.fixture
def site(tmp_path, monkeypatch) -> Path:
    """An installation of ours alone."""
    installed(tmp_path, "vidphys", PACKAGES)

    def distributions():
        return [
            importlib.metadata.PathDistribution(p) for p in sorted(tmp_path.glob("*.dist-info"))
        ]

    monkeypatch.setattr(importlib.metadata, "distributions", distributions)
    ours = importlib.metadata.PathDistribution(tmp_path / "vidphys-1.0.dist-info")
    version = importlib.metadata.version
    monkeypatch.setattr(importlib.metadata, "distribution", lambda _name: ours)
    monkeypatch.setattr(
        importlib.metadata, "version", lambda n: "1" if n == "vidphys" else version(n)
    )
    return tmp_path


def test_an_installation_of_ours_alone_is_well(site, capsys):
    assert owners.changed() == owners.changed(PACKAGES) == []
    assert owners.others(PACKAGES) == {}
    assert main(["doctor"]) == 0
    assert "as it was installed" in capsys.readouterr().out


@pytest.mark.parametrize("top_level", [True, False])
def test_another_distribution_that_takes_a_name_is_named_at_the_start(site, capsys, top_level):
    installed(site, "renderers-of-others", ("renderers",), top_level)
    assert owners.changed(PACKAGES) == ["renderers/__init__.py"]
    assert owners.others(PACKAGES) == {"renderers": ["renderers-of-others"]}
    assert main(["parts"]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "renderers/__init__.py is not the file that was installed with vidphys" in told
    assert "uninstall renderers-of-others" in told


def test_doctor_names_what_was_changed(site, capsys, monkeypatch):
    (site / "viz" / "__init__.py").write_text("changed = True\n")
    monkeypatch.setattr(cli, "_stranger", lambda: None)
    assert main(["doctor"]) == 1
    assert "viz/__init__.py: not as it was installed" in capsys.readouterr().out
    (site / "viz" / "__init__.py").unlink()
    assert owners.changed() == ["viz/__init__.py"]
