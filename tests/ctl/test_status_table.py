"""The text of `twindctl status`: a port that works, and with which something is wrong all the same."""

from typing import Any

import msgspec
import pytest

from tests.support.loop_stand_in import briefing, overview, tick
from twind.ctl.status_table import joint_lines, render, status_lines
from twind.front.state_cache import StateCache
from twind.link import BusInfo
from twind.robot.finding import Finding, ReasonCode
from twind.robot.recovery_steps import UNKNOWN

SLOW = "the adapter's latency timer is 16 ms; `sudo setserial /dev/ttyUSB0 low_latency`"
LONG = "its queue holds 1000 frames; `sudo ip link set can0 txqueuelen 48`"


def status(*warnings: str | None, **changes: Any) -> dict[str, Any]:
    """Status reply of a front whose overview has these warnings of its buses, and `changes`."""
    buses = [
        BusInfo(f"bus_{place}", f"/dev/ttyUSB{place}", True, 1.5, None, 0.4, 1000, 2, warning=warning)
        for place, warning in enumerate(warnings)
    ]
    world = StateCache(briefing())
    world.take(msgspec.structs.replace(overview(100.0), buses=buses, **changes))
    world.take(tick(100.0, 1))
    answer: dict[str, Any] = msgspec.json.decode(world.status())
    return answer


def test_each_warning_of_a_port_is_a_line_below_its_bus_in_full() -> None:
    lines = status_lines(status(SLOW, None, LONG, ""))
    first = next(place for place, line in enumerate(lines) if line.startswith("bus "))
    heads = ("bus", "warning", "bus", "bus", "warning", "bus")
    assert tuple(line.split()[0] for line in lines[first : first + 6]) == heads
    assert [line for line in lines if line.startswith("warning")] == [
        f"warning  bus_0: {SLOW}",
        f"warning  bus_2: {LONG}",
    ]


def test_torque_that_was_found_on_has_a_line_with_what_can_be_done() -> None:
    found = status(None)
    assert not [each for each in status_lines(found) if each.startswith("torque ")]
    found["inherited"] = True
    (line,) = [each for each in status_lines(found) if each.startswith("torque ")]
    assert "twindctl arm" in line and "twindctl disarm" in line


def test_ticks_are_counted_with_the_missed_ones() -> None:
    found = status(None)
    found["loop"] |= {"ticks": 60, "missed": 90}
    assert any("90 of 150 ticks missed" in line for line in status_lines(found))


def test_a_simulated_robot_shows_no_bus_no_latency_and_no_missing_connection() -> None:
    answer = status(None) | {"mode": "sim", "state": "disconnected"}
    answer["buses"][0] |= {"connected": False, "port": None}
    world = StateCache(briefing())
    world.take(overview(100.0))
    world.take(tick(100.0, 1))
    joint = msgspec.json.decode(world.joints())[0] | {"calibrated": False}
    text = render(answer, [joint])
    assert "mode sim · simulated robot · motion" in text
    for word in ("connected", "latency", "bus ", "unknown", "uncalibrated"):
        assert word not in text
    assert "simulated" not in render(answer | {"state": "fault"}).splitlines()[0]


def silent_joint(torque: bool | None, age_ms: float | None) -> dict[str, Any]:
    world = StateCache(briefing())
    world.take(overview(100.0))
    world.take(tick(100.0, 1))
    joint: dict[str, Any] = msgspec.json.decode(world.joints())[0]
    return joint | {"name": "elbow", "heard": False, "torque": torque, "age_ms": age_ms}


@pytest.mark.parametrize("age", [None, 501.0])
def test_a_joint_that_does_not_reply_is_named_without_a_latch_and_so_is_unknown_torque(
    age: float | None,
) -> None:
    """An acknowledged fault is no longer shown, and its servo may still hold torque."""
    answer = status(None) | {"mode": "live", "state": "connected", "faults": []}
    for torque, more in ((None, f": {UNKNOWN}"), (False, "")):
        text = render(answer, [silent_joint(torque, age)], table=False)
        assert f"silent   1 of 1 joints (elbow){more}" in text.splitlines()
        assert "age ms" not in text, "the table is only printed when it was asked for"
    mirror = answer | {"mode": "mirror"}
    assert "silent   1 of 1 joints (elbow)" in render(mirror, [silent_joint(None, age)]).splitlines()


@pytest.mark.parametrize(
    ("changes", "age"),
    [
        ({}, 499.0),
        ({"state": "disconnected"}, None),
        ({"state": "identifying"}, None),
        ({"mode": "sim"}, None),
    ],
)
def test_no_joint_is_called_silent_before_it_could_reply(changes: dict[str, Any], age: float | None) -> None:
    answer = status(None) | {"mode": "live", "state": "connected", "faults": []} | changes
    assert not [line for line in status_lines(answer, [silent_joint(None, age)]) if line.startswith("silent")]


def test_a_bus_without_a_port_names_the_option() -> None:
    answer = status(None)
    answer["buses"][0] |= {"connected": False, "port": None}
    assert "bus      bus_0: no port; start twind with --port, or with --virtual" in status_lines(answer)


ESTOP = Finding(ReasonCode.ESTOP, message="e-stop (settle)")
STALE = Finding(ReasonCode.STATE_STALE, joint=3, value=0.2, bound=0.1)
NEEDED = "reset    needed for ESTOP: "
NOT_NEEDED = "reset    not needed for STATE_STALE: "


@pytest.mark.parametrize(
    ("faults", "latched", "resets"),
    [
        ([], [], []),
        ([STALE], [], [NOT_NEEDED]),
        ([ESTOP], ["ESTOP"], [NEEDED]),
        ([ESTOP, STALE], ["ESTOP"], [NEEDED, NOT_NEEDED]),
        ([STALE, STALE], ["STATE_STALE"], ["reset    needed for STATE_STALE: "]),
    ],
)
def test_faults_have_remedies_and_say_which_of_them_a_reset_clears(
    faults: list[Finding], latched: list[str], resets: list[str]
) -> None:
    answer = status(SLOW, faults=faults, latched=latched)
    lines = status_lines(answer)
    of_faults = [line for line in lines if line.split()[0] in ("fault", "remedy", "reset")]
    assert lines[len(lines) - len(of_faults) :] == of_faults
    codes = {finding.code for finding in faults}
    heads = ["fault"] * len(faults) + ["remedy"] * len(codes) + ["reset"] * len(resets)
    assert [line.split()[0] for line in of_faults] == heads
    assert all(map(str.startswith, of_faults[len(of_faults) - len(resets) :], resets))
    assert render(answer).splitlines() == lines


@pytest.mark.parametrize(("state", "resets"), [("estop", "needed"), ("connected", "not needed")])
def test_without_latched_codes_the_state_says_whether_a_reset_is_needed(state: str, resets: str) -> None:
    answer = status() | {"state": state}
    del answer["latched"]
    assert status_lines(answer)[-1].startswith(f"reset    {resets} for STATE_STALE: ")


MENDED = "find and mend the cause, then `twindctl reset`"
WAIT = f"wait until torque is off, then {MENDED}"
LOWER = f"`twindctl disarm`, then {MENDED}"


@pytest.mark.parametrize(
    ("code", "torque", "steps"),
    [
        ("ESTOP", {"armed": True}, WAIT),
        ("ESTOP", {"armed": False, "inherited": True}, WAIT),
        ("ESTOP", {"armed": False, "torque_on": True}, WAIT),
        ("ESTOP", {"armed": False, "torque_on": False}, MENDED),
        ("ESTOP", {"armed": False, "mode": "sim"}, MENDED),
        ("OVERTEMP", {"armed": True}, LOWER),
        ("OVERTEMP", {"armed": False, "inherited": True}, LOWER),
        ("OVERTEMP", {"armed": False, "torque_on": False}, MENDED),
        ("PORT_LOST", {"armed": False}, f"{UNKNOWN}; next: {LOWER}"),
        ("PORT_LOST", {"armed": False, "mode": "mirror"}, MENDED),
        ("INTERNAL", {"armed": True, "state": "inhibited"}, f"support the robot, then {LOWER}"),
    ],
)
def test_the_steps_to_a_reset_depend_on_the_fault_and_on_torque(
    code: str, torque: dict[str, Any], steps: str
) -> None:
    answer = status(faults=[Finding(ReasonCode(code))], latched=[code]) | torque
    assert status_lines(answer)[-1] == f"reset    needed for {code}: {steps}"


@pytest.mark.parametrize(
    ("realtime", "denied", "end"),
    [
        ({"scheduler": "fifo 40"}, [], "ticks missed; fifo 40"),
        (
            {"scheduler": "no: Operation not permitted (CAP_SYS_NICE)"},
            ["scheduler"],
            "ticks missed; no real time: Operation not permitted (CAP_SYS_NICE)",
        ),
        ({"scheduler": "fifo 40"}, None, "ticks missed; fifo 40"),
        ({}, None, "ticks missed"),
    ],
)
def test_the_loop_line_ends_with_the_scheduler(
    realtime: dict[str, str], denied: list[str] | None, end: str
) -> None:
    answer = status()
    answer["loop"] |= {"realtime": realtime, "realtime_denied": denied}
    (loop,) = [line for line in status_lines(answer) if line.startswith("loop")]
    assert loop.endswith(end)


def test_an_unverified_joint_is_marked_and_an_uncalibrated_one_only_as_uncalibrated() -> None:
    world = StateCache(briefing())
    world.take(overview(100.0))
    world.take(tick(100.0, 1))
    joints = msgspec.json.decode(world.joints())
    assert [joint["verified"] for joint in joints] == [True] * 23 + [False]
    rows = joint_lines(joints)
    assert [place for place, row in enumerate(rows) if "unverified" in row] == [24]
    assert "silent, unverified" in rows[24]
    (alone,) = joint_lines([joints[-1] | {"calibrated": False}])[1:]
    assert "uncalibrated" in alone
    assert "unverified" not in alone


def test_without_a_connected_robot_no_joint_is_shown_as_verified() -> None:
    world = StateCache(briefing())
    world.take(msgspec.structs.replace(overview(100.0), verified=b""))
    world.take(tick(100.0, 1))
    joints = msgspec.json.decode(world.joints())
    assert {joint["verified"] for joint in joints} == {None}
    assert not any("verified" in row for row in joint_lines(joints))


STREAM: dict[str, Any] = {
    "name": "a1",
    "endpoint": "http://x/in",
    "rate_hz": 99.6,
    "sent": 12,
    "waiting": 3,
    "dropped": 0,
    "dead": 0,
    "failures": 0,
    "error": None,
}


def test_a_stream_has_a_line_with_its_losses_and_its_error() -> None:
    wrong = {**STREAM, "dropped": 2, "failures": 7, "error": "Connection refused"}
    lines = status_lines({**status(), "streams": [STREAM, wrong]})
    assert [line for line in lines if line.startswith("stream")] == [
        "stream   http://x/in: 99.6 Hz, 12 sent, 3 waiting",
        "stream   http://x/in: 99.6 Hz, 12 sent, 3 waiting, 2 DROPPED, 7 failures; Connection refused",
    ]
    assert not [line for line in status_lines(status()) if line.startswith("stream")]


def test_joints_without_a_watchdog_are_named_with_what_that_means() -> None:
    told: dict[str, Any] = status(None)
    assert told["unwatched"] == []
    assert not [line for line in status_lines(told) if line.startswith("watchdog")]
    (line,) = [
        line for line in status_lines(told | {"unwatched": list("abcd")}) if line.startswith("watchdog")
    ]
    assert line == (
        "watchdog none in 4 joints (a, b, c, ...): "
        "if the daemon dies, they drive on to their last goal and hold it"
    )
