"""Where a source has signs and decisions to turn round and tolerances to tighten.

Each place becomes a call of the probe with the place's number, so that one copy of the tree holds
all mutants and a switch chooses among them.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass

PROBE, SCALE = "mutation_probe", "_scale"

# Functions that return, or write, a force, a velocity, an energy, an impulse or a port's rate.
TERMS = frozenset(
    """
    energy force velocity momentum kick resist impulse bounce _bounced friction drive noise net
    moments coefficient rate slope slopes hamilton coriolis _hamilton pullback pushforward nll
    pair_energy pair_gradient disk_energy disk_gradient distance_energy triple_energy
    triple_gradient spline_energy spline_gradient unsquashed kinetic_energy relaxation_time
    steady_temperature free_force _accumulated _linear _square _dry _charge strength _strength
    straight_lines energies heights energy_scale curl_matrix coupling_stiffness simulate
    radial_spline plane_spline _plane_network _radial_network _pull _apart move_all bounced _back
    depth
    """.split()  # noqa: SIM905 (a list of names is read more easily)
)
BOUNDS = frozenset({"bar", "bound", "tolerance", "size", "amplitude"})  # names that tests give them


@dataclass(frozen=True)
class Place:
    """A sign, a tolerance or a decision.

    Args:
        kind: ``sign``, ``tolerance`` or ``decision``.
        file: path in the repository.
        line: in it.
        function: the function or method that it stands in.
        text: its expression.
    """

    kind: str
    file: str
    line: int
    function: str
    text: str


class _Rewriter(ast.NodeTransformer):
    kind: str

    def __init__(self, file: str, places: list[Place]) -> None:
        self.file, self.places = file, places
        self.scope: list[str] = []

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        return self._within(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        return self._within(node)

    def _within(self, node: ast.ClassDef | ast.FunctionDef) -> ast.AST:
        self.scope.append(node.name)
        node.body = [self.visit(statement) for statement in node.body]  # not the decorators
        self.scope.pop()
        return node

    def _call(self, name: str, node: ast.expr, *arguments: ast.expr) -> ast.Call:
        place = Place(self.kind, self.file, node.lineno, ".".join(self.scope), ast.unparse(node))
        number = ast.Constant(len(self.places))
        self.places.append(place)
        probe = ast.Attribute(ast.Name(PROBE, ast.Load()), name, ast.Load())
        return ast.copy_location(ast.Call(probe, [number, *arguments], []), node)


class Signs(_Rewriter):
    """Turns round what a physical function returns or writes, and each term of its sums."""

    kind = "sign"

    def visit(self, node: ast.AST) -> ast.AST:
        structural = isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        if structural or TERMS.intersection(self.scope):
            return super().visit(node)
        return node

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        node.value = self.visit(node.value)  # an index has no sign
        return node

    def visit_Return(self, node: ast.Return) -> ast.AST:
        if node.value is not None and not isinstance(node.value, ast.Constant):
            node.value = self._result(node.value)
        return node

    def _result(self, value: ast.expr) -> ast.expr:
        if isinstance(value, ast.Tuple):
            value.elts = [self._result(part) for part in value.elts]
            return value
        if isinstance(value, ast.UnaryOp):  # its own sign is the result's
            return self.visit(value)
        if isinstance(value, ast.List):
            return value  # findings, not numbers
        if isinstance(value, ast.Call) and "zeros" in ast.unparse(value.func):
            return value  # no force at all has no sign
        if isinstance(value, ast.IfExp) and _marks(value):
            return value  # a mark, which is asked whether it is zero
        return self._flipped(value)

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        return node  # a sign in an error's text is no term's

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        if isinstance(node.op, ast.USub) and not isinstance(node.operand, ast.Constant):
            node.operand = self._flipped(node.operand)
            return node
        return self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        node.left = self.visit(node.left)
        summed = isinstance(node.op, ast.Add | ast.Sub)
        node.right = self._flipped(node.right) if summed else self.visit(node.right)
        return node

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.AST:
        summed = isinstance(node.op, ast.Add | ast.Sub)
        node.value = self._flipped(node.value) if summed else self.visit(node.value)
        return node

    def visit_Assign(self, node: ast.Assign) -> ast.AST:
        targets = node.targets[0].elts if isinstance(node.targets[0], ast.Tuple) else node.targets
        written = all(isinstance(target, ast.Subscript) for target in targets)
        node.value = self._result(node.value) if written else self.visit(node.value)
        return node

    def visit_keyword(self, node: ast.keyword) -> ast.AST:
        if node.arg == "alpha":  # of a scaled sum
            node.value = self._flipped(ast.copy_location(ast.Constant(-1.0), node.value))
            return node
        return self.generic_visit(node)

    def _flipped(self, node: ast.expr) -> ast.expr:
        if _random(node):
            return self.visit(node)
        call = self._call("flip", node)
        call.args.append(self.visit(node))
        return call


def _marks(choice: ast.IfExp) -> bool:
    """Whether it chooses between zero and one."""
    return {ast.unparse(choice.body), ast.unparse(choice.orelse)} == {"zero", "one"}


def _random(term: ast.expr) -> bool:
    """Whether a product has a normal random factor: turned round, it is the same noise."""
    while isinstance(term, ast.BinOp) and isinstance(term.op, ast.Mult):
        if _random(term.right):
            return True
        term = term.left
    return isinstance(term, ast.Call) and "randn" in ast.unparse(term.func)


class Tolerances(_Rewriter):
    """Asks each comparison within a tolerance of a hundredth of it as well."""

    kind = "tolerance"
    inside = False  # of an assert statement

    def visit_Assert(self, node: ast.Assert) -> ast.AST:
        self.inside = True
        node.test = self.visit(node.test)
        self.inside = False
        return node

    def visit_Call(self, node: ast.Call) -> ast.AST:
        name = ast.unparse(node.func)
        if name == "pytest.approx":
            call = self._call("approx", node, *node.args)
        elif name in ("torch.allclose", "torch.testing.assert_close"):
            call = self._call("close", node, node.func, *node.args)
        else:
            return self.generic_visit(node)
        call.keywords = node.keywords
        return call

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        # A value between two bounds is held from both sides already.
        if not self.inside or len(node.ops) > 1 or not isinstance(node.ops[0], ast.Lt | ast.LtE):
            return self.generic_visit(node)
        bound = node.comparators[0]
        scaled = _Scaled().visit(ast.parse(ast.unparse(bound), mode="eval").body)
        if ast.unparse(scaled) == ast.unparse(bound):
            return self.generic_visit(node)
        call = self._call("below", node)
        asked = ast.parse(f"lambda {SCALE}: {ast.unparse(scaled)}", mode="eval").body
        call.args += [self.visit(node.left), asked, ast.Constant(isinstance(node.ops[0], ast.LtE))]
        return call


class Decisions(_Rewriter):
    """Turns round each comparison, and whatever else a function asks before it goes one way."""

    kind = "decision"

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        return node  # what an error says is no decision

    def visit_Assert(self, node: ast.Assert) -> ast.AST:
        return node  # for whoever reads, and for types

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        return self._turned(node)

    def visit_If(self, node: ast.If) -> ast.AST:
        return self._asked(node)

    def visit_While(self, node: ast.While) -> ast.AST:
        return self._asked(node)

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        return self._asked(node)

    def visit_comprehension(self, node: ast.comprehension) -> ast.AST:
        node.ifs = [self._test(test) for test in node.ifs]
        node.iter = self.visit(node.iter)
        return node

    def _asked(self, node: ast.If | ast.While | ast.IfExp) -> ast.AST:
        node.test = self._test(node.test)
        test, node.test = node.test, ast.Constant(True)
        self.generic_visit(node)
        node.test = test
        return node

    def _test(self, test: ast.expr) -> ast.expr:
        return self.visit(test) if isinstance(test, ast.Compare) else self._turned(test)

    def _turned(self, node: ast.expr) -> ast.expr:
        if not self.scope:
            return node  # asked once, when the module is loaded
        call = self._call("turn", node)
        call.args.append(self.generic_visit(node))
        return call


class _Scaled(ast.NodeTransformer):
    """A bound whose numbers with a point, and names of bounds, are multiplied by a scale."""

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        return self._times(node) if isinstance(node.value, float) else node

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return self._times(node) if node.id in BOUNDS else node

    @staticmethod
    def _times(node: ast.expr) -> ast.expr:
        return ast.BinOp(ast.Name(SCALE, ast.Load()), ast.Mult(), node)


def rewritten(source: str, kind: type[_Rewriter], file: str, places: list[Place]) -> str:
    """A source that asks the probe; its places are added to the list."""
    tree = ast.parse(source)
    kind(file, places).visit(tree)
    first = 1 if ast.get_docstring(tree) is not None else 0
    for statement in tree.body[first:]:
        first += isinstance(statement, ast.ImportFrom) and statement.module == "__future__"
    tree.body.insert(first, ast.Import([ast.alias(PROBE)]))
    return ast.unparse(ast.fix_missing_locations(tree))
