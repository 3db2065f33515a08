"""Z11, Z14, Z15: what comes from outside with the package, and what is promised of it."""

from __future__ import annotations

import ast
import re
import tomllib

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.hostile.test_sources import FILES, HOME, calls


def test_z11_no_scene_of_an_engine_is_read_from_a_file():
    """MuJoCo is given text that we wrote; nothing of ours reads MJCF, or what it includes."""
    told = {}
    for file in FILES:
        source = file.read_text(encoding="utf-8")
        named = calls(ast.parse(source)) if "from_xml_path" in source else ()
        found = {name for name, _ in named if "from_xml_path" in name}
        found |= set(re.findall(r"<include|<mesh|meshdir|assetdir|texturedir", source))
        if found:
            told[str(file.relative_to(HOME))] = found
    assert told == {}


@pytest.fixture(scope="module")
def locked() -> dict[str, list[str]]:
    """Each package of the lock and its hashes."""
    text = (HOME / "requirements.lock").read_text(encoding="utf-8").replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    return {
        canonicalize_name(re.split(r"[=\s;\[]", line)[0]): re.findall(r"sha256:[0-9a-f]{64}", line)
        for line in lines
    }


def test_z14_every_package_of_the_lock_has_its_hash(locked):
    assert len(locked) > 50
    assert [name for name, hashes in locked.items() if not hashes] == []


def test_z14_all_that_is_asked_for_is_locked(locked):
    project = tomllib.loads((HOME / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = [*project["dependencies"], *project["optional-dependencies"]["test"]]
    names = {canonicalize_name(Requirement(text).name) for text in asked}
    assert names - {"vidphys"} <= set(locked)


def test_z14_nothing_is_fetched_when_it_is_built():
    built = tomllib.loads((HOME / "pyproject.toml").read_text(encoding="utf-8"))
    assert not (HOME / "setup.py").exists()
    assert "cmdclass" not in built.get("tool", {}).get("setuptools", {})


def test_z15_what_is_trusted_and_how_to_report_is_written_down():
    text = (HOME / "SECURITY.md").read_text(encoding="utf-8")
    for part in ("## What is trusted", "**A hole** is", "**No hole** is", "## To report"):
        assert part in text
