"""Z1, Z2, Z5, Z13, Z16: what the sources never do, told from their syntax."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

HOME = Path(__file__).parents[2]
PACKAGES = (
    *("vidphys", "viz", "encoders", "registry", "loops", "dynamics", "binders", "renderers"),
    *("readouts", "benchmarks"),
)
FILES = sorted(file for name in PACKAGES for file in (HOME / name).rglob("*.py"))
UNPICKLES = {"load", "loads", "Unpickler"}
# What was pickled in the same line, to see that another process could be handed it.
OWN = {
    ("vidphys/testing/failed.py", "pickle.loads"),
    ("vidphys/runs/worker.py", "pickle.loads"),
    ("vidphys/cli/drawing.py", "pickle.loads"),  # and what a child says to its parent by its pipe
}


def calls(tree: ast.AST) -> Iterator[tuple[str, dict[str, object]]]:
    """Dotted names of what is called, each with its plain keywords."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            given = {
                k.arg: k.value.value if isinstance(k.value, ast.Constant) else ...
                for k in node.keywords
                if k.arg is not None
            }
            yield ast.unparse(node.func), given


def wrong(source: str, file: str = "x.py") -> list[str]:
    """What a source does that it must not."""
    tree = ast.parse(source)
    found = []
    for node in ast.walk(tree):
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{a.name}" for a in node.names]
        for name in names:
            top, _, last = name.partition(".")
            if top in {"joblib", "dill", "cloudpickle", "yaml", "shelve", "marshal", "hydra"}:
                found.append(f"Z1 {name}")
            if top == "pickle" and last in UNPICKLES:
                found.append(f"Z1 {name}")
    for name, given in calls(tree):
        module, _, last = name.rpartition(".")
        if module in ("pickle", "_pickle") and last in UNPICKLES and (file, name) not in OWN:
            found.append(f"Z1 {name}")
        if name in ("eval", "exec", "__import__", "os.system", "os.popen", "builtins.eval"):
            found.append(f"Z16 {name}")
        if name == "torch.load" and given.get("weights_only") is not True:
            found.append("Z2 torch.load without weights_only=True")
        if last == "load" and module in ("np", "numpy") and given.get("allow_pickle") is not False:
            found.append("Z1 np.load without allow_pickle=False")
        if given.get("allow_pickle", False) is not False:
            found.append(f"Z1 {name} with allow_pickle")
        if given.get("trust_remote_code", False) is not False:
            found.append(f"Z5 {name} with trust_remote_code")
        if given.get("shell", False) is not False:
            found.append(f"Z16 {name} with shell")
        plain = module.endswith("Config") or given.get("use_safetensors") is True
        if last == "from_pretrained" and not (plain and given.get("trust_remote_code") is False):
            found.append(f"Z5 {name}, which may load what a folder names")
    return found


@pytest.mark.parametrize("package", PACKAGES)
def test_z01_z02_z05_z16_the_package_unpickles_nothing_and_runs_no_text(package):
    files = [file for file in FILES if file.is_relative_to(HOME / package)]
    assert files
    told = {}
    for file in files:
        name = str(file.relative_to(HOME))
        found = wrong(file.read_text(encoding="utf-8"), name)
        if found:
            told[name] = found
    assert not told


@pytest.mark.parametrize(
    "source",
    [
        "import joblib",
        "from pickle import loads",
        "import pickle; pickle.load(f)",
        "import torch; torch.load(p)",
        "import torch; torch.load(p, weights_only=False)",
        "import numpy as np; np.load(p)",
        "np.load(p, allow_pickle=True)",
        "np.load(p, allow_pickle=flag)",
        "AutoModel.from_config(c, trust_remote_code=True)",
        "AutoModel.from_pretrained('x')",
        "AutoModel.from_pretrained('x', trust_remote_code=False)",
        "AutoModel.from_pretrained('x', use_safetensors=True, trust_remote_code=asked)",
        "subprocess.run('ls', shell=True)",
        "os.system('ls')",
        "eval(text)",
        "import yaml",
    ],
)
def test_the_scan_sees_what_it_is_for(source):
    assert wrong(source)


def test_z02_torch_is_one_whose_safe_loader_is():
    project = tomllib.loads((HOME / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = {r.name: r for r in map(Requirement, project["dependencies"])}
    least = min(Version(s.version) for s in asked["torch"].specifier if s.operator == ">=")
    assert least >= Version("2.10")


def test_z13_nothing_tells_of_the_user_or_the_machine():
    """No record holds the environment, nor who is at work where."""
    asked = {"getpass.getuser", "socket.gethostname", "platform.node", "os.getlogin", "os.uname"}
    spoken = {"vidphys/cli/view.py": {"socket.gethostname"}}  # on the screen, in a line for ssh
    for file in FILES:
        name = str(file.relative_to(HOME))
        source = file.read_text(encoding="utf-8")
        named = any(call.rpartition(".")[2] in source for call in asked)
        found = {call for call, _ in calls(ast.parse(source))} & asked if named else set()
        assert found <= spoken.get(name, set()), name
        assert "dict(os.environ)" not in source, name
