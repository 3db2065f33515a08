"""Nothing outlives a run: what no source may do, found in its syntax."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

HOME = Path(__file__).resolve().parents[2]
ROOMS = ("vidphys", "dynamics", "readouts", "binders", "encoders", "renderers", "viz", "registry")
CACHES = {"lru_cache", "cache"}
WORKERS = {"vidphys/runs/worker.py"}  # beside verbs and ``__main__``: where a process begins

ALLOWED = {
    "writes a frozen object": {
        "vidphys/training/ensemble.py",  # makes one of mapped leaves, which no check may see
        "vidphys/placement.py",  # makes one on another device, which no check need see again
    },
    "caches on module level": {
        "dynamics/pairs.py",  # numbers of pairs, a few integers for each count of bodies
        "dynamics/triples.py",  # likewise
        "dynamics/engines.py",  # what this machine has, which no run changes
        "dynamics/compiled/head.py",  # compiled code, as numba keeps it
        "vidphys/diagnose/formula/grammar.py",  # the words of formulas, which are constants
        "vidphys/runs/code.py",  # a hash of the sources, which no run changes
        "vidphys/data/video.py",  # the decoder's version, which no run changes
        "vidphys/probing/atlas.py",  # the clips of an atlas, decoded once for all its units
        "vidphys/data/sets/__init__.py",  # lists of clips, by their files' times of change
        "vidphys/data/sets/apart.py",  # rows of their tables, likewise
        "vidphys/data/formats/animals.py",  # the arrays of a file, by when it was changed
        "viz/page.py",  # the pages' templates, which are constants
    },
    "sets threads": set(),
    "changes a recorder's origin": set(),
}


def _name(node: ast.expr) -> str:
    """The last name of ``a.b.c``, ``c`` or ``c(...)``."""
    node = node.func if isinstance(node, ast.Call) else node
    return getattr(node, "attr", getattr(node, "id", ""))


def _sins(node: ast.AST, file: str) -> Iterator[str]:
    targets = node.targets if isinstance(node, ast.Assign) else []
    for target in targets:
        if isinstance(target, ast.Subscript) and _name(target.value) == "__dict__":
            yield "writes a frozen object"
        if isinstance(target, ast.Attribute) and ast.unparse(target).endswith("recorder.origin"):
            yield "changes a recorder's origin"
    if isinstance(node, ast.Call) and ast.unparse(node.func) == "object.__setattr__":
        yield "writes a frozen object"
    decorators = getattr(node, "decorator_list", [])
    if any(_name(decorator) in CACHES for decorator in decorators):
        yield "caches on module level"
    begins = file.startswith("vidphys/cli/") or file.endswith("__main__.py") or file in WORKERS
    if isinstance(node, ast.Call) and _name(node) == "set_num_threads" and not begins:
        yield "sets threads"


def found_in(source: str, file: str) -> set[str]:
    return {sin for node in ast.walk(ast.parse(source)) for sin in _sins(node, file)}


def test_no_state_outlives_a_run():
    files = [file for room in ROOMS for file in (HOME / room).rglob("*.py")]
    assert len(files) > 300
    told = []
    for file in files:
        name = str(file.relative_to(HOME))
        found = found_in(file.read_text("utf-8"), name)
        told += [(name, sin) for sin in found if name not in ALLOWED[sin]]
    assert told == []


@pytest.mark.parametrize(
    ("source", "sin"),
    [
        ("x.__dict__['a'] = 1", "writes a frozen object"),
        ("object.__setattr__(x, 'a', 1)", "writes a frozen object"),
        ("@functools.lru_cache(maxsize=1)\ndef f(): ...", "caches on module level"),
        ("torch.set_num_threads(1)", "sets threads"),
        ("recorder.origin = other", "changes a recorder's origin"),
    ],
)
def test_each_is_seen(source, sin):
    assert found_in(source, "vidphys/x.py") == {sin}
    assert found_in("self.origin = origin\nset_num_threads(1)", "vidphys/cli/x.py") == set()


def test_a_test_of_a_full_disk_writes_no_compiled_module():
    # cut short at the limit, it would stand where all later imports find it
    files = (HOME / "tests").rglob("test_*.py")
    texts = {file.name: file.read_text("utf-8") for file in files if file != Path(__file__)}
    full = {name for name, text in texts.items() if "setrlimit(resource.RLIMIT_FSIZE" in text}
    assert len(full) == 4
    assert not [n for n in full if not re.search('"-B"|dont_write_bytecode', texts[n])]
