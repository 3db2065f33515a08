"""Which file imports which: no circles, and who may know of the fast ways to compute."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
PACKAGES = [*CONTRACTS["root_packages"], "benchmarks", "tests"]


def modules(root: Path, package: str) -> dict[str, Path]:
    """Files of a package by their modules' names."""
    files = (root / package).rglob("*.py")
    named = {file: file.relative_to(root).with_suffix("").parts for file in files}
    return {".".join(p[:-1] if p[-1] == "__init__" else p): file for file, p in named.items()}


def imported(tree: ast.AST) -> Iterator[tuple[str, str | None]]:
    """What a file imports, inside functions too, but for types alone: a module, a name in it."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.Import):
            yield from ((alias.name, None) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, "imports name the whole module"
            yield from ((node.module, alias.name) for alias in node.names)
        yield from imported(node)


def graph(root: Path, package: str) -> dict[str, set[str]]:
    """Each module of a package, and which others of it are imported there."""
    files = modules(root, package)
    found: dict[str, set[str]] = {}
    for module, file in files.items():
        asked = [(x, f"{x}.{name}") for x, name in imported(ast.parse(file.read_text()))]
        found[module] = {whole if whole in files else x for x, whole in asked} & set(files)
    return found


@pytest.mark.parametrize("package", PACKAGES)
def test_no_files_import_each_other_in_a_circle(package):
    try:
        TopologicalSorter(graph(ROOT, package)).prepare()
    except CycleError as error:
        pytest.fail(f"a circle of files: {' <- '.join(error.args[1])}")


def test_a_circle_is_found_also_where_a_function_holds_it_open(tmp_path):
    package = tmp_path / "made"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "one.py").write_text("from made import two\n")
    (package / "two.py").write_text("def late():\n    from made.one import two\n")
    with pytest.raises(CycleError):
        TopologicalSorter(graph(tmp_path, "made")).prepare()
    guarded = "if TYPE_CHECKING:\n    from made import one\n"
    (package / "two.py").write_text(f"from typing import TYPE_CHECKING\n{guarded}")
    TopologicalSorter(graph(tmp_path, "made")).prepare()


def test_no_physics_knows_what_makes_it_fast():
    """Files that import-linter's contract does not name yet are held to it as well."""
    fast = "dynamics.engines", "dynamics.compiled"
    for module, others in graph(ROOT, "dynamics").items():
        if module != "dynamics" and not module.startswith(fast):
            assert not [x for x in others if x.startswith(fast)], module
