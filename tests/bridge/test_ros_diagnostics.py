"""State of robot and daemon as ROS messages: labelled latencies, and diagnostics that name each fault."""

import math
from typing import Any

import pytest

from tests.support.picture_messages import HOPS, bus, hop, joints, loop, status
from twind.bridge.ros.ros_diagnostics import ERROR, FIELDS, OK, WARN, Diagnostics, command_latency, latencies
from twind.ros import DIAGNOSTIC_ARRAY, FLOAT, FLOATS, decode

HAND = {"code": "ESTOP", "message": "by hand"}
BRIDGE = {
    "daemon": True,
    "error": None,
    "commands": True,
    "refuses": None,
    "node": "/twind",
    "dropped": 0,
    "undelivered": 0,
    "driving": 0,
}


def rows(diagnostics: Diagnostics, bridge: Any = BRIDGE, known: Any = None, seen: Any = ()) -> dict[str, Any]:
    message = decode(DIAGNOSTIC_ARRAY, diagnostics.message(7_000_000_000, bridge, known, seen))
    assert message["header"]["stamp"] == {"sec": 7, "nanosec": 0}
    return {row["name"].removeprefix("twind: "): row for row in message["status"]}


def values(row: Any) -> dict[str, str]:
    return {each["key"]: each["value"] for each in row["values"]}


def test_every_latency_has_its_row_and_what_is_unknown_is_nan() -> None:
    hops = [hop(name, place) for place, name in enumerate(HOPS)]
    hops[2]["p99_ms"] = None
    message = decode(FLOATS, latencies(hops))
    high, wide = message["layout"]["dim"]
    assert high["label"] == f"hop: {', '.join(HOPS)}" and wide["label"].split(", ") == list(FIELDS)
    assert (high["size"], high["stride"], wide["size"], wide["stride"]) == (10, 80, 8, 8)
    table = [message["data"][place * 8 : place * 8 + 8] for place in range(10)]
    assert math.isnan(table[2][FIELDS.index("p99_ms")])
    assert table[4] == [hops[4][key] for key in FIELDS]


def test_the_latency_is_that_of_the_last_command_in_seconds() -> None:
    hops = [hop(name, place) for place, name in enumerate(HOPS)]
    command = next(each for each in hops if each["hop"] == "command")
    assert decode(FLOAT, command_latency(hops))["data"] == pytest.approx(command["now_ms"] / 1e3)
    command["now_ms"] = None
    assert math.isnan(decode(FLOAT, command_latency(hops))["data"])
    assert math.isnan(decode(FLOAT, command_latency([]))["data"])


def test_a_daemon_without_latencies_is_an_empty_table() -> None:
    message = decode(FLOATS, latencies([]))
    assert message["data"] == [] and message["layout"]["dim"][0]["size"] == 0


def test_all_is_well_where_all_is_well() -> None:
    found = rows(Diagnostics(), known=status(), seen=joints())
    assert {row["level"] for row in found.values()} == {OK} and len(found) == 5 + 24
    assert values(found["joint l_knee"])["temperature"] == "41"


def test_an_absent_daemon_is_an_error_and_old_robot_rows_are_not_published() -> None:
    found = rows(Diagnostics(), BRIDGE | {"daemon": False, "error": "no daemon"}, None, joints())
    assert list(found) == ["bridge"] and found["bridge"]["level"] == ERROR
    assert found["bridge"]["message"] == "no daemon"


@pytest.mark.parametrize(
    ("name", "level", "words", "known", "seen"),
    [
        ("bus upper", ERROR, "not connected", {"buses": [bus("upper", connected=False)]}, {}),
        ("bus upper", WARN, "its adapter", {"buses": [bus("upper", warning="its adapter is slow")]}, {}),
        ("joint l_knee", ERROR, "overload", {}, {"l_knee": {"faults": ["overload"]}}),
        ("joint l_knee", WARN, "no reply", {}, {"l_knee": {"heard": False}}),
        ("robot", ERROR, "ESTOP: by hand", {"state": "estop", "faults": [HAND]}, {}),
        ("robot", WARN, "ESTOP: by hand", {"faults": [HAND]}, {}),
    ],
)
def test_a_fault_appears_in_its_diagnostics_row(
    name: str, level: int, words: str, known: dict[str, Any], seen: dict[str, Any]
) -> None:
    row = rows(Diagnostics(), known=status(**known), seen=joints(**seen))[name]
    assert row["level"] == level and words in row["message"]


def test_in_sim_no_bus_is_missing_and_no_joint_silent() -> None:
    unopened = [bus("upper", connected=False)]
    seen = joints(l_knee={"heard": False})
    found = rows(Diagnostics(), known=status(mode="sim", buses=unopened), seen=seen)
    assert {row["level"] for row in found.values()} == {OK}


def test_counts_that_grew_warn_once_and_a_new_daemon_is_no_growth() -> None:
    told = Diagnostics()
    rows(told, known=status(loop=loop(missed=3), buses=[bus("upper", errors=5)]))
    grown = rows(told, BRIDGE | {"dropped": 2}, status(loop=loop(missed=5), buses=[bus("upper", errors=9)]))
    assert grown["loop"]["level"] == WARN and "2 ticks missed" in grown["loop"]["message"]
    assert grown["bus upper"]["level"] == WARN and "4 errors" in grown["bus upper"]["message"]
    assert grown["bridge"]["level"] == WARN and "2 messages" in grown["bridge"]["message"]
    again = rows(told, BRIDGE | {"dropped": 2}, status(loop=loop(missed=0), buses=[bus("upper")]))
    assert {row["level"] for row in again.values()} == {OK}
    slow = rows(told, BRIDGE | {"dropped": 2, "undelivered": 4})["bridge"]
    assert slow["level"] == WARN and "4 messages were dropped: a reader" in slow["message"]


def test_an_unknown_value_is_published_as_unknown() -> None:
    found = rows(
        Diagnostics(), known=status(lease=None, latency_ms=None), seen=joints(l_knee={"voltage": None})
    )
    assert values(found["robot"])["lease"] == "free" and values(found["robot"])["latency_ms"] == "unknown"
    assert values(found["joint l_knee"])["voltage"] == "unknown"
