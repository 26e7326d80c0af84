"""Kinds of mutants: small changes of a module's syntax tree, each of which a test ought to notice.

Left alone, because no behaviour hangs on them: annotations, docstrings, strings (the words of messages; a
string that decides stands in a comparison, which is turned), decorators, `assert` and `strict=` (both only
guard against slips of the programmer), imports.
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
SUMS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr,
    ast.BitXor: ast.BitOr,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
OPPOSITES = {
    **{"min": "max", "max": "min", "all": "any", "any": "all", "minimum": "maximum", "maximum": "minimum"},
    **{"floor": "ceil", "ceil": "floor", "argmin": "argmax", "argmax": "argmin", "union": "intersection"},
    **{"zeros_like": "ones_like", "ones_like": "zeros_like", "fmin": "fmax", "fmax": "fmin"},
}
# A member of an enumeration becomes this one, or the second where it is this one.
MEMBERS = {
    "ReasonCode": ("INTERNAL", "BUSY"),
    "RobotState": ("CONNECTED", "ARMED"),
    "_S": ("CONNECTED", "ARMED"),
    "RobotEvent": ("ARM", "RESET"),
    "Mode": ("LIVE", "SIM"),
    "Motion": ("IDLE", "ACTIVE"),
    "Reaction": ("NONE", "HOLD"),
    "Instruction": ("PING", "READ"),
    "StatusErrorCode": ("NONE", "CRC"),
}


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change: `owner.field` (or its `place`) becomes `new`."""

    owner: ast.AST
    field: str
    place: int | None
    new: object
    line: int  # of the change
    lines: tuple[int, int]  # first and last line of the statement's own part
    scope: str  # qualified name of the outermost function around it; "" on the module or in a class body
    words: str  # "before -> after"

    def switch(self) -> object:
        """Put the change into the tree; returns what stood there. The tree must be used once, or restored."""
        rows = getattr(self.owner, self.field)
        if self.place is None:
            setattr(self.owner, self.field, self.new)
            return rows
        old = rows[self.place]
        rows[self.place] = self.new
        return old


class _Walk:
    """Depth first through the tree, knowing scope and statement."""

    def __init__(self) -> None:
        self.found: list[Mutant] = []
        self.scope: list[str] = []
        self.function: str = ""
        self.lines = (0, 0)

    def add(self, node: ast.AST, owner: ast.AST, field: str, place: int | None, new: ast.AST) -> None:
        ast.copy_location(new, node)
        ast.fix_missing_locations(new)
        words = f"{_short(node)} -> {_short(new)}"
        line = getattr(node, "lineno", self.lines[0])
        self.found.append(Mutant(owner, field, place, new, line, self.lines, self.function, words))

    def visit(self, node: ast.AST, owner: ast.AST, field: str, place: int | None) -> None:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            self._definition(node)
            return
        if isinstance(node, ast.Import | ast.ImportFrom | ast.Assert | ast.JoinedStr):
            return
        if isinstance(node, ast.keyword) and node.arg in ("strict", "message"):
            return
        before = self.lines
        if isinstance(node, ast.stmt):
            self.lines = (node.lineno, _end_of_head(node))
        for new in _changes(node):
            self.add(node, owner, field, place, new)
        self._children(node, skip=("annotation", "returns"))
        self.lines = before

    def _children(self, node: ast.AST, skip: tuple[str, ...] = ()) -> None:
        for name, value in ast.iter_fields(node):
            if name in skip:
                continue
            if isinstance(value, ast.AST):
                self.visit(value, node, name, None)
            elif isinstance(value, list):
                for place, item in enumerate(value):
                    if isinstance(item, ast.AST):
                        self.visit(item, node, name, place)

    def _definition(self, node: ast.FunctionDef | ast.ClassDef) -> None:
        """Bodies are in their function; default values belong to what is around it."""
        before = self.lines, self.function
        if isinstance(node, ast.FunctionDef):
            self.lines = (node.lineno, node.lineno)
            for rows in (node.args.defaults, node.args.kw_defaults):
                for place, value in enumerate(rows):
                    if value is not None:
                        owner = node.args
                        name = "defaults" if rows is node.args.defaults else "kw_defaults"
                        self.visit(value, owner, name, place)
            self.function = self.function or ".".join([*self.scope, node.name])
        self.scope.append(node.name)
        for place, item in enumerate(node.body):
            self.visit(item, node, "body", place)
        self.scope.pop()
        self.lines, self.function = before


def _end_of_head(node: ast.stmt) -> int:
    body = getattr(node, "body", None)
    return max(node.lineno, body[0].lineno - 1) if isinstance(body, list) and body else node.end_lineno or 0


def _short(node: ast.AST) -> str:
    text = " ".join(ast.unparse(node).split()) or "(nothing)"
    return text if len(text) <= 90 else f"{text[:60]} … {text[-25:]}"


def _changes(node: ast.AST) -> Iterator[ast.AST]:
    """Replacements of `node`."""
    if isinstance(node, ast.Compare):
        yield from _comparisons(node)
    elif isinstance(node, ast.BinOp) and type(node.op) in SUMS:
        yield ast.BinOp(node.left, SUMS[type(node.op)](), node.right)
    elif isinstance(node, ast.AugAssign):
        if type(node.op) in SUMS:
            yield ast.AugAssign(node.target, SUMS[type(node.op)](), node.value)
        yield ast.Pass()
    elif isinstance(node, ast.UnaryOp) and not isinstance(node.op, ast.UAdd):
        yield node.operand
    elif isinstance(node, ast.BoolOp):
        yield ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
        yield from node.values  # each part alone
    elif isinstance(node, ast.Constant):
        yield from _constants(node.value)
    elif isinstance(node, ast.Name) and node.id in OPPOSITES:
        yield ast.Name(OPPOSITES[node.id], node.ctx)
    elif isinstance(node, ast.Attribute):
        yield from _attributes(node)
    elif isinstance(node, ast.If | ast.While | ast.IfExp) and _plain(node.test):
        yield from _turned(node)
    elif isinstance(node, ast.comprehension):
        for place in range(len(node.ifs)):
            rest = [other for i, other in enumerate(node.ifs) if i != place]
            yield ast.comprehension(node.target, node.iter, rest, 0)
    elif isinstance(node, ast.Dict) and len(node.keys) > 1:
        for place in range(len(node.keys)):
            keep = [i for i in range(len(node.keys)) if i != place]
            yield ast.Dict([node.keys[i] for i in keep], [node.values[i] for i in keep])
    elif isinstance(node, ast.stmt):
        yield from _statements(node)


def _comparisons(node: ast.Compare) -> Iterator[ast.AST]:
    for place, op in enumerate(node.ops):
        for other in COMPARISONS[type(op)]:
            ops = [*node.ops[:place], other(), *node.ops[place + 1 :]]
            yield ast.Compare(node.left, ops, node.comparators)


def _constants(value: object) -> Iterator[ast.AST]:
    if isinstance(value, bool):
        yield ast.Constant(not value)
    elif isinstance(value, int):
        yield ast.Constant(value + 1)
        yield ast.Constant(value - 1) if value else ast.UnaryOp(ast.USub(), ast.Constant(1))
    elif isinstance(value, float):
        yield from (ast.Constant(value * 1.1), ast.Constant(value * 0.9)) if value else (ast.Constant(1.0),)
    elif isinstance(value, bytes) and value:
        yield ast.Constant(value[:-1] + bytes((value[-1] ^ 1,)))


def _attributes(node: ast.Attribute) -> Iterator[ast.AST]:
    if node.attr in OPPOSITES:
        yield ast.Attribute(node.value, OPPOSITES[node.attr], node.ctx)
    elif isinstance(node.value, ast.Name) and node.value.id in MEMBERS and node.attr.isupper():
        first, second = MEMBERS[node.value.id]
        yield ast.Attribute(node.value, second if node.attr == first else first, node.ctx)


def _plain(test: ast.expr) -> bool:
    """A condition that no other operator turns."""
    return isinstance(test, ast.Name | ast.Attribute | ast.Call | ast.Subscript | ast.NamedExpr)


def _turned(node: ast.If | ast.While | ast.IfExp) -> Iterator[ast.AST]:
    test = ast.UnaryOp(ast.Not(), node.test)
    if isinstance(node, ast.IfExp):
        yield ast.IfExp(test, node.body, node.orelse)
    else:
        yield type(node)(test, node.body, node.orelse)


def _statements(node: ast.stmt) -> Iterator[ast.AST]:
    if isinstance(node, ast.Return) and node.value is not None:
        if not (isinstance(node.value, ast.Constant) and node.value.value is None):
            yield ast.Return(ast.Constant(None))
    elif isinstance(node, ast.Continue):
        yield ast.Break()
    elif isinstance(node, ast.Break):
        yield ast.Continue()
    elif _acts(node):
        yield ast.Pass()


def _acts(node: ast.stmt) -> bool:
    """A statement that does something beside giving a name: without a name nothing would run at all."""
    if isinstance(node, ast.Assign):
        return not isinstance(node.targets[0], ast.Name | ast.Tuple)
    return isinstance(node, ast.Raise) or (
        isinstance(node, ast.Expr) and not isinstance(node.value, ast.Constant)
    )


def mutants(tree: ast.Module) -> list[Mutant]:
    """Every mutant of a module, in the order of its text."""
    walk = _Walk()
    for place, node in enumerate(tree.body):
        walk.visit(node, tree, "body", place)
    return walk.found
