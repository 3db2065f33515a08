"""What `make test` leaves out, it shows by other tests of the same file."""

from __future__ import annotations

import ast
from pathlib import Path

TESTS = Path(__file__).parents[1]
FILES = sorted(TESTS.rglob("test_*.py"))
SLOW = "pytest.mark.slow"


def _names(body: list[ast.stmt], slow: bool) -> list[str]:
    """Of tests, those that are marked slow or those that are not."""
    found = []
    for one in body:
        marked = SLOW in map(ast.unparse, getattr(one, "decorator_list", []))
        if isinstance(one, ast.ClassDef) and not marked:
            found += _names(one.body, slow)
        elif isinstance(one, ast.FunctionDef) and one.name.startswith("test_") and marked == slow:
            found.append(one.name)
    return found


def test_a_file_with_slow_tests_has_quick_ones() -> None:
    bodies = {path: ast.parse(path.read_text(encoding="utf-8")).body for path in FILES}
    slow = {path for path, body in bodies.items() if _names(body, slow=True)}
    assert not [path.name for path in slow if not _names(bodies[path], slow=False)]


def test_what_is_marked_is_found() -> None:
    text = """
@pytest.mark.slow
@pytest.mark.parametrize("x", [1])
def test_one(x): ...
class TestAll:
    @pytest.mark.slow
    def test_two(self): ...
    def test_three(self): ...
"""
    body = ast.parse(text).body
    assert _names(body, slow=True) == ["test_one", "test_two"]
    assert _names(body, slow=False) == ["test_three"]
