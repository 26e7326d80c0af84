"""Evaluation of Python expressions in `${...}` of xacro files, from a list of permitted kinds of nodes.

No lambda, no name with a leading underscore. Attributes are keys of dictionaries and simple methods.
"""

import ast
from collections.abc import Mapping
from typing import Any

from twind.exceptions import InvalidInput
from twind_calibration.model_import.imported_model import import_refused

MAX_LENGTH = 10_000
PERMITTED = (
    *(ast.Expression, ast.Constant, ast.Name, ast.Attribute, ast.Subscript, ast.Slice, ast.Starred),
    *(ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.Call, ast.keyword),
    *(ast.List, ast.Tuple, ast.Dict, ast.Set, ast.ListComp, ast.SetComp, ast.DictComp, ast.comprehension),
    *(ast.operator, ast.unaryop, ast.boolop, ast.cmpop, ast.expr_context),
)
TEXT_METHODS = frozenset(
    (
        "lower",
        "upper",
        "strip",
        "lstrip",
        "rstrip",
        "split",
        "replace",
        "startswith",
        "endswith",
        "join",
        "find",
    )
)
# Methods of each type; `format` of a text reaches attributes of its arguments and is not among them.
METHODS: Mapping[type, frozenset[str]] = {
    str: TEXT_METHODS,
    dict: frozenset(("get", "keys", "values", "items")),
    list: frozenset(("index", "count")),
    tuple: frozenset(("index", "count")),
}
_ATTRIBUTE = "__attribute"


def evaluate(text: str, symbols: Any) -> Any:
    """Value of an expression. Raises InvalidInput for what is not permitted, else as Python does."""
    if len(text) > MAX_LENGTH:
        raise import_refused(f"expression of {len(text)} characters, at most {MAX_LENGTH}; split it")
    tree = ast.parse(text.strip(), mode="eval")
    for node in ast.walk(tree):
        name = node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""
        if not isinstance(node, PERMITTED) or name.startswith("_"):
            thing = repr(name) if name else type(node).__name__
            raise _refused(text, thing, "only values, operators, calls and comprehensions are")
    tree = ast.fix_missing_locations(_AttributeCalls().visit(tree))
    dict.update(symbols, __builtins__={_ATTRIBUTE: lambda value, name: _attribute(text, value, name)})
    return eval(compile(tree, "<expression>", "eval"), symbols)


class _AttributeCalls(ast.NodeTransformer):
    """Replaces each `value.name` by a call that checks it."""

    def visit_Attribute(self, node: ast.Attribute) -> ast.Call:
        """Replace one attribute."""
        self.generic_visit(node)
        function = ast.Name(_ATTRIBUTE, ast.Load())
        return ast.copy_location(ast.Call(function, [node.value, ast.Constant(node.attr)], []), node)


def _attribute(text: str, value: Any, name: str) -> Any:
    """Attribute of a value, if its type permits it."""
    if isinstance(value, dict) and type(value) is not dict and name in value:  # as xacro does
        return value[name]
    for kind, methods in METHODS.items():
        if isinstance(value, kind) and name in methods:
            return getattr(value, name)
    raise _refused(
        text, f".{name} of a {type(value).__name__}", "keys of dictionaries and simple methods are"
    )


def _refused(text: str, thing: str, rule: str) -> InvalidInput:
    return import_refused(f"${{{text[:80]}}}: {thing} is not evaluated: {rule}; write the value")
