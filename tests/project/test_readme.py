"""README and docs are run: Python blocks as they stand, commands through their own parsers."""

import importlib
import re
import shlex
from pathlib import Path

import pytest
import tyro

from vidphys.cli import VERBS, main

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
TEXTS = {page: page.read_text(encoding="utf-8") for page in PAGES}
BLOCKS = [
    block for text in TEXTS.values() for block in re.findall(r"```(\w+)\n(.*?)```", text, re.S)
]
PYTHON = [body for language, body in BLOCKS if language == "python"]
COMMANDS = [
    shlex.split(line, comments=True)
    for language, body in BLOCKS
    if language == "sh"
    for line in body.splitlines()
    if line.strip()
]


def test_there_is_something_to_run():
    assert len(PYTHON) >= 1 and len(COMMANDS) >= 8


@pytest.mark.parametrize("body", PYTHON)
def test_python_blocks_run(body, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(body, "README.md", "exec"), {})
    said = capsys.readouterr().out
    assert "False" not in said and said.strip()


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_commands_parse(command):
    if command[0] == "make":
        targets = (ROOT / "Makefile").read_text(encoding="utf-8")
        assert re.search(rf"^{command[1]}:", targets, flags=re.M)
    elif command[0] == "vidphys":
        verb = command[1]
        config = getattr(importlib.import_module(f"vidphys.cli.{verb}"), VERBS[verb][0])
        tyro.cli(config, args=command[2:])
    else:
        assert command[0] == "export"


def test_the_weights_are_listed(capsys):
    assert main(["weights", "list"]) == 0
    assert "hiera" in capsys.readouterr().out.lower()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_a_page_names_is_there(page):
    for link in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", TEXTS[page]):
        assert (page.parent / link).exists(), link
    for path in re.findall(r"`([\w/]+\.py)`", TEXTS[page]):
        assert (ROOT / path).exists() or (ROOT / "vidphys" / path).exists(), path


def test_the_front_door_is_short():
    assert len(TEXTS[ROOT / "README.md"].splitlines()) <= 130
