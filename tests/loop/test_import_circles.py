"""No module imports one that imports it, imports for type checking and inside functions included."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from twind.loop.procedures.procedure_context import ProcedureContext

HOME = Path(__file__).parents[2]
TREES = {
    "twind": HOME / "twind",
    "twind_drivers": HOME / "drivers/twind_drivers",
    "twind_calibration": HOME / "calibration/twind_calibration",
}
LOOP = HOME / "twind/loop"


def modules() -> dict[str, Path]:
    """Every module of the program by its dotted name."""
    found = {}
    for package, root in TREES.items():
        for path in root.rglob("*.py"):
            parts = (package, *path.relative_to(root).with_suffix("").parts)
            found[".".join(part for part in parts if part != "__init__")] = path
    return found


def imports(tree: ast.AST, name: str, package: bool, known: set[str]) -> Iterator[str]:
    """Modules that the tree of module `name` imports, anywhere in it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom):
            above = name.split(".")[: (0 if package else -1) or None]
            above = above[: len(above) - node.level + 1] if node.level else []
            source = ".".join([*above, *([node.module] if node.module else [])])
            below = [f"{source}.{alias.name}" for alias in node.names]
            submodules = [each for each in below if each in known]
            yield from submodules
            if source in known and len(submodules) < len(below):
                yield source


def graph() -> dict[str, set[str]]:
    """Imports of every module."""
    every = modules()
    known = set(every)
    return {
        name: {
            each
            for each in imports(ast.parse(path.read_text()), name, path.stem == "__init__", known)
            if each != name
        }
        for name, path in every.items()
    }


def circles(edges: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules that import each other, directly or not (Tarjan's components of several)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(edges.get(node, ())):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            group = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(group) > 1:
                found.append(sorted(group))

    for node in sorted(edges):
        if node not in index:
            visit(node)
    return found


def test_no_two_modules_import_each_other() -> None:
    assert circles(graph()) == []


@pytest.mark.parametrize(
    "line",
    [
        "from pack.one import thing",
        "from .one import thing",
        "from . import one",
        "import pack.one",
        "if TYPE_CHECKING:\n    from pack.one import thing",
        "def late():\n    from pack import one",
    ],
)
def test_every_form_of_an_import_closes_a_circle(line: str) -> None:
    known = {"pack", "pack.one", "pack.two"}
    back = set(imports(ast.parse(line), "pack.two", False, known))
    assert back == {"pack.one"}
    assert circles({"pack.one": {"pack.two"}, "pack.two": back}) == [["pack.one", "pack.two"]]
    assert circles({"pack.one": set(), "pack.two": back}) == []


# ----------------------------------------------------------------------------------- who sees the whole loop


def test_a_procedure_reaches_eight_members_of_the_loop() -> None:
    members = [name for name in vars(ProcedureContext) if not name.startswith("_")]
    assert len(members) <= 8


def test_few_functions_take_the_whole_loop() -> None:
    takers = []
    for path in [*LOOP.rglob("*.py"), HOME / "twind/cli.py"]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                named = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                notes = [ast.unparse(each.annotation) for each in named if each.annotation is not None]
                if any(note.strip("'\"") == "Loop" for note in notes):
                    takers.append(f"{path.stem}.{node.name}")
    assert len(takers) <= 10, takers


def test_the_loop_has_few_attributes_and_copies_no_parts() -> None:
    tree = ast.parse((LOOP / "tick/control_loop.py").read_text())
    [loop] = [node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == "Loop"]
    [begin] = [node for node in loop.body if isinstance(node, ast.FunctionDef) and node.name == "__init__"]
    made = {
        node.attr
        for node in ast.walk(loop)
        if isinstance(node, ast.Attribute)
        and isinstance(node.ctx, ast.Store)
        and ast.unparse(node.value) == "self"
    }
    assert len(made) <= 15, made
    copied = [
        line
        for line in begin.body
        if isinstance(line, ast.Assign)
        and ast.unparse(line.value).startswith("parts.")
        and isinstance(line.value, ast.Attribute)
    ]
    assert len(copied) <= 3, "clock, hardware and executor: what a procedure reaches"
