"""The library names arguments; only the command line speaks of its options."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = (
    "registry",
    "loops",
    "dynamics",
    "renderers",
    "encoders",
    "binders",
    "readouts",
    "vidphys",
)
COMMAND_LINES = ("vidphys/cli/", "vidphys/pretraining/__main__.py", "vidphys/pretraining/figure.py")
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")
TOLD = re.compile(r"--[\w-]+(=\S+)?")  # a whole one, told to a program


def options_in(path):
    """Line and text of each string that speaks of an option."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        text = node.value if isinstance(node, ast.Constant) else None
        if isinstance(text, str) and OPTION.search(text) and not TOLD.fullmatch(text):
            yield f"{path.relative_to(ROOT)}:{node.lineno}: {text}"


@pytest.mark.parametrize("package", PACKAGES)
def test_no_string_speaks_of_an_option(package):
    files = (ROOT / package).rglob("*.py")
    kept = [f for f in files if not f.relative_to(ROOT).as_posix().startswith(COMMAND_LINES)]
    assert not [said for file in sorted(kept) for said in options_in(file)]
