"""What would break on a card by surprise is found by reading the code: 0 places.

In the stages, which compute wherever their input lies, a tensor that is made says on which device;
a generator too; and nothing is handed to numpy that may lie on a card.
"""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
STAGES = ("dynamics", "renderers", "encoders", "binders", "readouts")
MAKERS = {
    *("arange", "as_tensor", "empty", "eye", "full", "linspace", "logspace", "ones", "rand"),
    *("randint", "randn", "randperm", "tensor", "tril_indices", "triu_indices", "zeros"),
}
# What computes on the CPU alone: loops for it, numbers read by hand, pictures of files.
ON_THE_CPU = {
    "dynamics/compiled",
    "renderers/compiled.py",
    "encoders/entry.py",
    "encoders/store.py",
    "encoders/tensors.py",
}
PLACED = {"to", "type_as", "cuda"}  # a tensor that is taken somewhere at once
BUILDING = {"__init__", "_build", "reset_parameters"}  # of modules, which are moved as a whole


def files():
    for stage in STAGES:
        for path in sorted((ROOT / stage).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            if not any(name == kept or name.startswith(f"{kept}/") for kept in ON_THE_CPU):
                yield path


def violations(source):
    """(line, what is wrong) of some code."""
    tree, found = ast.parse(source), []
    parent = {child: node for node in ast.walk(tree) for child in ast.iter_child_nodes(node)}
    for node in ast.walk(tree):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
            continue
        made = ast.unparse(node.func)
        told = {keyword.arg for keyword in node.keywords}
        if made.removeprefix("torch.") in MAKERS and made.startswith("torch."):
            if not told & {"device", None} and not _placed(node, parent):
                found.append((node.lineno, f"{made}(...) says no device"))
        elif made in ("torch.Generator", "Generator") and not told and not _placed(node, parent):
            found.append((node.lineno, f"{made}() says no device"))
        elif node.func.attr == "numpy" and not node.args and not _on_cpu(node.func.value):
            found.append((node.lineno, ".numpy() without .cpu()"))
    return found


def _placed(node, parent):
    """Whether what is made is taken to a device in the same breath, or is a part of a module."""
    while node in parent:
        above = parent[node]
        if isinstance(above, ast.Attribute) and above.attr in PLACED:
            return True
        if isinstance(above, ast.Call) and ast.unparse(above.func).endswith(
            ("nn.Parameter", "Parameter", "register_buffer")
        ):
            return True
        if isinstance(above, ast.FunctionDef):
            return above.name in BUILDING
        node = above
    return True  # of a module's top: a constant, which is placed where it is used


def _on_cpu(value):
    return "cpu()" in ast.unparse(value)


@pytest.mark.parametrize("path", list(files()), ids=lambda p: p.relative_to(ROOT).as_posix())
def test_what_is_made_says_where(path):
    assert not violations(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("source", "count"),
    [
        ("def f(x): return x + torch.ones(2)", 1),
        ("def f(x): return x + torch.ones(2, device=x.device)", 0),
        ("def f(x): return x + torch.ones(2).to(x)", 0),
        ("def f(x): return x.numpy()", 1),
        ("def f(x): return x.cpu().numpy()", 0),
        ("def f(x): return torch.Generator()", 1),
        ("class M:\n  def __init__(self): self.a = nn.Parameter(torch.zeros(2))", 0),
    ],
)
def test_the_rule_sees(source, count):
    assert len(violations(source)) == count
