"""Event codes are members of an enumeration wherever the program emits one."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from twind.bridge.commands.motion_end import BUSY, LEASE_LOST, MOTION
from twind.robot.event_codes import EventCode
from twind.robot.finding import ReasonCode
from twind.robot.modes import RobotState

PROGRAM = Path(__file__).parents[2] / "twind"
EMITS = re.compile(r"\b(event|write|mark|Event)\(")  # only such files are parsed
EMITTERS = {"event": 1, "write": 1, "mark": 1}  # methods of Responder and DaemonLog; the code's place


def _bare_codes(source: str) -> Iterator[int]:
    """Lines with an event or a log line whose code is a literal string."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else ast.unparse(node.func)
        codes = [each.value for each in node.keywords if each.arg == "code" and name in {"Event", *EMITTERS}]
        if name in EMITTERS:
            codes += node.args[EMITTERS[name] : EMITTERS[name] + 1]
        if any(
            isinstance(part, ast.Constant) and isinstance(part.value, str)
            for code in codes
            for part in _values(code)
        ):
            yield node.lineno


def _values(code: ast.expr) -> list[ast.expr]:
    """Expression itself, and both sides of a conditional one."""
    return [code, code.body, code.orelse] if isinstance(code, ast.IfExp) else [code]


def test_program_emits_no_bare_event_code() -> None:
    texts = {str(path): path.read_text("utf-8") for path in PROGRAM.rglob("*.py")}
    emitting = {name: text for name, text in texts.items() if EMITS.search(text)}
    found = [f"{name}:{line}" for name, text in emitting.items() for line in _bare_codes(text)]
    assert not found, "use a member of EventCode, ReasonCode or RobotState"


def test_enumerations_share_no_code() -> None:
    codes = [str(code) for kind in (EventCode, ReasonCode, RobotState) for code in kind]
    assert len(codes) == len(set(codes))


def test_values_on_the_wire_stay() -> None:
    words = """CALL_BROKE DAMP DESCRIPTORS END EPISODE_BEGIN EPISODE_END FAILSAFE FLIGHT_LEFT_OUT
        FLIGHT_NOT_WRITTEN FLIGHT_WRITTEN FRONT_BROKE GAP_GROWN GAP_STOPPED HOMING LATENCY_CALM LINES_LOST
        LOOKAHEAD LOOP_SILENT MOTION NOTE ONEWAY_FLOOD PACE PORT_WARNING REBOOT REGISTER RELOADED
        RELOAD_REFUSED SETTLE SLOW_READER START STOPPING latency"""
    assert sorted(EventCode) == words.split()


def test_codes_of_the_ros_node_are_members() -> None:
    assert MOTION == EventCode.MOTION
    assert (LEASE_LOST, BUSY) == (ReasonCode.LEASE_LOST, ReasonCode.BUSY)
