"""What is wrong with a verb's options is told in one line."""

from __future__ import annotations

import pytest

from vidphys.cli import main
from vidphys.cli.parsed import in_a_line

WRONG = [
    (["diagnose"], "Missing from vidphys diagnose: PATH;"),
    (
        ["ladder", "--presets", "quick"],
        "Unrecognized options: --presets, quick; perhaps you meant: --preset "
        "{quick,standard,paper};",
    ),
    (["ladder", "--preset", "huge"], "invalid choice 'huge' for argument '--preset'."),
    (["ladder", "--seeds", "two"], "--seeds 'two': must be INT;"),
    (["diagnose", "a.csv", "b.csv"], "Unrecognized options: b.csv;"),
    (["diagnose", "a.csv", "--hold-out", "much"], "--hold-out: could not convert string"),
    (["rollout", "a", "b", "--beyond"], "Missing value for argument '--beyond'"),
]


@pytest.mark.parametrize("columns", ["60", "80", "300"])
@pytest.mark.parametrize("arguments, words", WRONG)
def test_a_wrong_option_is_one_line(arguments, words, columns, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", columns)
    assert main(arguments) == 2
    told = capsys.readouterr()
    assert told.out == "" and told.err.count("\n") == 1
    line = f"error: {' '.join(told.err[7:].split())}"
    assert line == told.err.strip()
    assert line.startswith("error: ") and words in line
    assert line.endswith(f"; `vidphys help {arguments[0]}` shows the options")
    assert not set(line) & set("│─╭╮╰╯") and "---" not in line


def test_it_is_read_from_boxes_as_from_rules():
    lines = (
        "╭─ Value error ─────────────────────────────────────────╮",
        "│ Error parsing --seeds: no type matching {None}|INT    │",
        "│ could be instantiated from ['two'].                   │",
        "│ ───────────────────────────────────────────────────── │",
        "│ For full helptext, see x --help                       │",
        "╰───────────────────────────────────────────────────────╯",
    )
    boxed = "\n".join(lines)
    assert in_a_line(boxed) == "--seeds 'two': must be INT"


def test_what_is_drawn_otherwise_is_told_as_it_is():
    assert in_a_line("no box\nat all") == "no box at all"
