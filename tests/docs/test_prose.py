"""No program reads a text made for people: codes, ids and fields say what happened, so words may change.

What this file finds in the source `test_prose_live.py` shows on running programs.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("twind", "drivers/twind_drivers", "calibration/twind_calibration", "bench")
# What holds a text for people: attributes, keys and names. Exceptions have one as well (`str(error)`).
TEXTS = {"message", "reason", "trouble", "warning", "measured", "thing", "advice", "why"}
NAMES = {"reason", "trouble"}  # of variables; a `message` may be bytes of a protocol
READS = {
    *("partition", "rpartition", "split", "rsplit", "find", "rfind", "index", "rindex"),
    *("startswith", "endswith", "removeprefix", "removesuffix"),
}
MATCHES = {"match", "fullmatch", "search", "findall", "finditer", "split"}
# Where a text is taken apart all the same, and why nothing depends on its words.
FOREIGN = "the library has no code for it: its own text, not ours"
SHOWN = "a text for people becomes another one: nothing depends on its words"
ALLOWED = {
    ("twind/bridge/zenoh/zenoh_session.py", "_words"): SHOWN,
    ("calibration/twind_calibration/model_import/xacro_child.py", "_where"): FOREIGN,
    ("twind/front/flight_folder.py", "write"): "a name of the flight recorder's own, not a sentence",
    ("twind/doctor/robot_files.py", "check_model"): SHOWN,
    ("drivers/twind_drivers/can/can_bringup.py", "_warn"): SHOWN,
    ("drivers/twind_drivers/ports/python_can_channel.py", "_warn"): SHOWN,
    ("drivers/twind_drivers/ports/python_can_channel.py", "_is_queue_full"): FOREIGN,
    ("drivers/twind_drivers/ports/serial_port.py", "_open"): FOREIGN,
    ("drivers/twind_drivers/ports/serial_port.py", "_reason"): FOREIGN,
}


def is_text(node: ast.expr, errors: set[str]) -> bool:
    """Is it a text for people? `errors`: names of exceptions here."""
    match node:
        case ast.Name(id=name):
            return name in NAMES
        case ast.Attribute(attr=name):
            return name in TEXTS or (name == "args" and is_error(node.value, errors))
        case ast.Subscript(value=value, slice=ast.Constant(value=key)):
            return key in TEXTS or is_text(value, errors)
        case ast.Call(func=ast.Attribute(attr="get"), args=[ast.Constant(value=key), *_]):
            return key in TEXTS
        case ast.Call(func=ast.Name(id="str" | "repr"), args=[of]):
            return is_error(of, errors) or is_text(of, errors)
        case ast.Call(func=ast.Attribute(value=value, attr="lower" | "strip" | "casefold" | "upper")):
            return is_text(value, errors)
    return False


def is_error(node: ast.expr, errors: set[str]) -> bool:
    """Is it an exception?"""
    return isinstance(node, ast.Name) and node.id in errors


def reads(node: ast.AST, errors: set[str]) -> bool:
    """Does it take a text apart, or look for words in it?"""
    if not isinstance(node, ast.Call | ast.Compare):
        return False  # nine nodes of ten
    match node:
        case ast.Call(func=ast.Attribute(value=value, attr=name), args=[_, *_]) if name in READS:
            return is_text(value, errors)  # without an argument `split` lays words out anew
        case ast.Call(func=ast.Attribute(attr=name), args=args) if name in MATCHES:
            return any(is_text(each, errors) for each in args)
        case ast.Compare(ops=[ast.In() | ast.NotIn()], left=left, comparators=[where]):
            return is_text(where, errors) and not isinstance(left, ast.Tuple)
        case ast.Compare(ops=[ast.Eq() | ast.NotEq()], left=left, comparators=[right]):
            words = [each for each in (left, right) if isinstance(each, ast.Constant) and each.value]
            return bool(words) and (is_text(left, errors) or is_text(right, errors))
    return False


def found(source: str) -> Iterator[tuple[int, str]]:
    """Lines that read a text for people, and the function they stand in."""

    def visit(node: ast.AST, function: str, errors: set[str]) -> Iterator[tuple[int, str]]:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            function = node.name
            errors = exceptions(node)
        elif isinstance(node, ast.ExceptHandler) and node.name:
            errors = errors | {node.name}
        if reads(node, errors):
            yield getattr(node, "lineno", 0), function
        for child in ast.iter_child_nodes(node):
            yield from visit(child, function, errors)

    yield from visit(ast.parse(source), "", set())


def exceptions(function: ast.FunctionDef | ast.AsyncFunctionDef) -> set[str]:
    """Arguments of a function that are exceptions, by their annotation."""
    given = {each.arg: ast.unparse(each.annotation) for each in function.args.args if each.annotation}
    return {name for name, kind in given.items() if kind.endswith(("Error", "Exception", "Refused"))}


def sources() -> Iterator[Path]:
    for room in ROOMS:
        yield from sorted((ROOT / room).rglob("*.py"))


def test_no_program_code_parses_a_message_text() -> None:
    reading = [
        (str(path.relative_to(ROOT)), line, function)
        for path in sources()
        for line, function in found(path.read_text())
    ]
    assert [each for each in reading if (each[0], each[2]) not in ALLOWED] == []
    assert {(path, function) for path, _, function in reading} == set(ALLOWED), "no exception is left over"


@pytest.mark.parametrize(
    "line",
    [
        'name, _, phase = event["message"].partition(" ")',
        'unit = reason.partition(":")[0]',
        'ids = trouble[4:] if trouble.startswith("old") else ""',
        'if finding.message == "not read yet": pass',
        'found = re.match(r"(.*) aborted", event.message)',
        'if port.trouble.startswith("gone"): pass',
        """
try:
    pass
except CallError as error:
    silent = "no reply" in str(error)
""",
        """
try:
    pass
except KeyError as error:
    near = str(error.args[0]).partition("near: ")
""",
    ],
)
def test_a_line_that_parses_a_message_text_is_found(line: str) -> None:
    assert list(found(line)) != []


@pytest.mark.parametrize(
    "line",
    ['if event["code"] == "MOTION": pass', 'print(event["message"])', "if not finding.message: pass"],
)
def test_codes_and_whole_texts_are_no_reading(line: str) -> None:
    assert list(found(line)) == []
