"""The README is run: its Python blocks as they stand, its commands through their own parsers."""

import importlib
import re
import shlex
from pathlib import Path

import pytest
import tyro

from vidphys.cli import VERBS, main

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", TEXT, flags=re.S)
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
def test_python_blocks_run(body, capsys):
    exec(compile(body, "README.md", "exec"), {})
    assert "stayed finite: True" in capsys.readouterr().out


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


@pytest.mark.parametrize("path", re.findall(r"\]\(([^)#:]+)\)", TEXT))
def test_linked_files_exist(path):
    assert (ROOT / path).exists()


@pytest.mark.parametrize("path", re.findall(r"`([\w/]+\.py)`", TEXT))
def test_named_files_exist(path):
    assert (ROOT / path).exists()
