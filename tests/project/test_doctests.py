"""The examples in the docstrings: each runs as it stands, and every main road has one."""

import ast
import doctest
import importlib
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
    "viz",
    "vidphys",
)
MAIN_ROADS = {
    "renderers": {"Camera", "gaussians", "disks", "RgbWorld", "centroids"},
    "encoders": {"FeatureMap", "FeatureStore", "ConvEncoder", "load_encoder"},
    "binders": {"Tracks", "MotionBinder", "bind_by_acceleration", "follow"},
    "readouts": {"AttentionReadout", "soft_argmax", "central_difference", "smooth"},
    "dynamics": {"PhaseState", "Parameters", "build", "rollout", "Integrator", "Hamiltonian"},
    "vidphys": {"Run", "gravity", "fit", "aim", "by_shooting", "diagnose_motion", "pick", "nmse"},
    "registry": {"Registry"},
}
PUBLIC = 40


def examples_of(path):
    """Module, qualified name and docstring of each example in a file."""
    text = path.read_text(encoding="utf-8")
    if ">>> " not in text:
        return
    module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")

    def walk(node, names):
        for child in node.body:
            if isinstance(child, ast.ClassDef | ast.FunctionDef):
                below = (*names, child.name)
                if ">>> " in (ast.get_docstring(child) or ""):
                    yield module, ".".join(below), ast.get_docstring(child)
                yield from walk(child, below)

    yield from walk(ast.parse(text), ())


FOUND = [
    example
    for package in PACKAGES
    for path in sorted((ROOT / package).rglob("*.py"))
    for example in examples_of(path)
]


@pytest.mark.parametrize("module, name, text", FOUND, ids=[f"{m}.{n}" for m, n, _ in FOUND])
def test_an_example_runs(module, name, text):
    names = dict(vars(importlib.import_module(module)))
    example = doctest.DocTestParser().get_doctest(text, names, name, module, 0)
    said = []
    doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(example, out=said.append)
    assert not said, "".join(said)


def test_enough_public_names_have_one():
    public = {name for _, name, _ in FOUND if not any(n.startswith("_") for n in name.split("."))}
    assert len(public) >= PUBLIC


@pytest.mark.parametrize("package", MAIN_ROADS)
def test_the_main_road_of_a_stage_has_examples(package):
    has = {name for module, name, _ in FOUND if module.split(".")[0] == package}
    assert MAIN_ROADS[package] <= has
