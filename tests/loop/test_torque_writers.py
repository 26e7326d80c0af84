"""Each field of the torque state has one module that writes it."""

import ast
import itertools
from pathlib import Path

from twind.loop.procedures.torque_state import TorqueState

TWIND = Path(__file__).parents[2] / "twind"
OWNER = TWIND / "loop/procedures/torque_state.py"
FIELDS = {name for name, kind in vars(TorqueState).items() if isinstance(kind, property)}


def assigned(tree: ast.AST) -> list[tuple[str, str]]:
    """(owner, attribute) of every assignment to an attribute."""
    found = []
    for node in ast.walk(tree):
        targets: list[ast.expr] = []
        if isinstance(node, ast.Assign):
            targets = list(node.targets)
        elif isinstance(node, ast.AugAssign | ast.AnnAssign):
            targets = [node.target]
        elif isinstance(node, ast.Delete):
            targets = list(node.targets)
        for target in itertools.chain.from_iterable(ast.walk(each) for each in targets):
            if isinstance(target, ast.Attribute) and isinstance(target.ctx, ast.Store | ast.Del):
                found.append((ast.unparse(target.value), target.attr))
    return found


def test_each_field_has_one_module_that_writes_it() -> None:
    writers: dict[str, set[Path]] = {field: set() for field in FIELDS}
    for module in TWIND.rglob("*.py"):
        for owner, name in assigned(ast.parse(module.read_text())):
            field = name.removeprefix("_")
            torque = owner.split(".")[-1] in ("torque", "_torque")
            if field in FIELDS and (torque or (module == OWNER and owner == "self")):
                writers[field].add(module)
    assert len(FIELDS) == 11
    assert writers == {field: {OWNER} for field in FIELDS}


def test_the_search_for_writers_sees_every_form() -> None:
    forms = "loop.torque.armed = 1\na, context.torque.held = 1, 2\nx.torque._held |= 3\ndel y.torque.armed"
    assert len(assigned(ast.parse(forms))) == 4


def test_torque_state_reads_no_device_and_no_clock() -> None:
    imports = [
        node.module for node in ast.walk(ast.parse(OWNER.read_text())) if isinstance(node, ast.ImportFrom)
    ]
    assert imports == ["twind.robot.arrays"]
