"""An end-stop search that ends early, tick by tick: why, and that torque is off and everything undone."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import pytest

from tests.support.procedure_rig import BROKEN, PERIOD, SILENT
from tests.support.restore_rig import KNEE, TURN
from tests.support.search_rig import CAP, CLIENT, OTHER_MODE, START, Search
from twind.loop.procedures.procedure_runner import Priority, Procedure
from twind.motion.endstop_search import EndstopSearch
from twind.robot.finding import Finding, ReasonCode
from twind.safety.state_machine import RobotEvent
from twind_drivers.bus import WireRangeError

STALE = Finding(
    ReasonCode.STATE_STALE, KNEE, bound=0.1, message="s since its last reading: check cable and power"
)
HEAT = Finding(ReasonCode.OVERCURRENT, 0, message="not armed before it rests")
LATCHED = Finding(ReasonCode.WIRE_CLAMP, 2, message="made up")
GONE = Finding(ReasonCode.SOCKETS_GONE, message="control.sock: removed")


@pytest.fixture
def scene(monkeypatch: pytest.MonkeyPatch) -> Search:
    return Search(monkeypatch)


def connected(scene: Search, on: bool) -> None:
    scene.rig.hardware.connected = on


ENDS: Mapping[str, tuple[Callable[[Search], Any], Finding]] = {
    "a client cancels it": (
        lambda scene: scene.homing.cancel(),
        Finding(ReasonCode.STOP_NOT_FOUND, KNEE, message="a client cancelled the search"),
    ),
    "its client gives the lease back": (
        lambda scene: scene.lease.release(CLIENT),
        Finding(ReasonCode.LEASE_LOST, message="the lease is gone"),
    ),
    "another client takes the lease": (
        lambda scene: scene.lease.acquire(9, "other", 1000, scene.rig.clock.now(), take=True),
        Finding(ReasonCode.LEASE_LOST, message="the lease is gone"),
    ),
    "the guard bars it": (lambda scene: setattr(scene.guard, "bars", (HEAT,)), HEAT),
    "no client can connect": (lambda scene: setattr(scene.rig.condition, "unreachable", GONE), GONE),
    "a bus is not identified": (
        lambda scene: connected(scene, False),
        Finding(ReasonCode.HW_DISCONNECTED, message="a bus was lost, or its devices are identified anew"),
    ),
    "a fault is latched": (lambda scene: scene.rig.condition.latch(LATCHED), LATCHED),
    "the state is left": (
        lambda scene: scene.rig.condition.change(RobotEvent.CALIBRATED),
        Finding(ReasonCode.NOT_ARMED, message="the robot is connected: it was disarmed, or a bus was lost"),
    ),
    "another joint has torque": (
        lambda scene: scene.rig.hardware.slow.torque.__setitem__(0, 1),
        Finding(ReasonCode.TORQUE_MISMATCH, 0, value=1.0, bound=0.0, message="its torque is on"),
    ),
}
STAGES = ("look", "current mode", "prepare", "energise")


def undone(scene: Search, name: str) -> None:
    """End the condition, so that its servo can be restored."""
    if name == "a bus is not identified":
        connected(scene, True)
    scene.rig.hardware.slow.torque[0] = 0


@pytest.mark.parametrize("name", ENDS)
def test_each_condition_ends_a_search_that_moves(scene: Search, name: str) -> None:
    ends, why = ENDS[name]
    scene.ask()
    scene.until_moving()
    ends(scene)
    goals = len(scene.servo.goals)
    scene.rig.ticks(1)
    assert len(scene.servo.goals) == goals, "a goal was sent after it"
    assert "cut" in scene.servo.log
    undone(scene, name)
    assert scene.findings() == [why]


@pytest.mark.parametrize("name", ENDS)
@pytest.mark.parametrize("stage", STAGES)
def test_each_condition_ends_a_search_at_each_request(scene: Search, name: str, stage: str) -> None:
    ends, why = ENDS[name]
    scene.servo.during[stage] = lambda: ends(scene)
    scene.ask()
    scene.until_asked(stage)
    scene.rig.ticks(1)
    undone(scene, name)
    assert scene.findings() == [why]
    following = {"look": "current mode", "current mode": "prepare", "prepare": "energise"}
    assert stage == "energise" or following[stage] not in scene.servo.log
    assert ("cut" in scene.servo.log) == (stage == "energise")


@pytest.mark.parametrize("name", ENDS)
def test_each_condition_ends_a_search_that_waits_for_readings(scene: Search, name: str) -> None:
    ends, why = ENDS[name]
    scene.ask()
    scene.rig.ticks(4)
    ends(scene)
    scene.rig.ticks(1)
    assert scene.rig.procedures.rank is None
    undone(scene, name)
    assert scene.findings() == [why] and scene.servo.log == ["all"]


@pytest.mark.parametrize("stage", STAGES[1:])
def test_a_joint_without_readings_ends_it_after_a_tenth_of_a_second(scene: Search, stage: str) -> None:
    scene.ask()
    scene.until_asked(stage)
    scene.hears = False
    begun = scene.rig.hardware.readings.raw.heard_at[KNEE]
    scene.until(lambda: scene.rig.procedures.rank is None or "cut" in scene.servo.log)
    age = scene.rig.clock.now() - begun
    assert 0.1 < age <= 0.1 + PERIOD + 1e-9
    scene.hears = True
    [finding] = scene.findings()
    assert finding.value == pytest.approx(age) and replace(finding, value=None) == STALE


def test_a_joint_without_readings_while_it_moves_ends_it(scene: Search) -> None:
    scene.ask()
    scene.until_moving()
    scene.hears = False
    scene.until_asked("cut")
    scene.hears = True
    [finding] = scene.findings()
    assert (finding.code, finding.joint) == (ReasonCode.STATE_STALE, KNEE)


def test_a_joint_that_does_not_hang_still_is_not_touched(scene: Search) -> None:
    swings = iter([30.0, -30.0] * 1000)
    scene.servo.limp = lambda count: count + next(swings)
    scene.ask()
    [finding] = scene.findings()
    assert (finding.code, finding.joint) == (ReasonCode.STOP_NOT_FOUND, KNEE)
    assert scene.servo.log == ["all"]


# ------------------------------------------------------------------------------- errors of requests


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (ValueError("no mode 5"), ReasonCode.STOP_NOT_FOUND, "no mode 5"),
        (BROKEN, ReasonCode.BUS_ERRORS, "the bus is broken"),
        (KeyError("led"), ReasonCode.INTERNAL, "KeyError('led')"),
    ],
)
@pytest.mark.parametrize("stage", STAGES)
def test_an_error_of_a_request_ends_it(
    scene: Search, stage: str, error: Exception, code: ReasonCode, text: str
) -> None:
    scene.servo.failing[stage] = error
    scene.ask()
    assert scene.findings() == [Finding(code, KNEE, message=text)]
    internal = code is ReasonCode.INTERNAL
    assert (ReasonCode.INTERNAL in scene.rig.condition.latches) == internal
    assert ("give back" in scene.servo.log) == (stage != "look")
    assert ("cut" in scene.servo.log) == (stage == "energise")


@pytest.mark.parametrize("stage", ["prepare", "goal"])
def test_bytes_that_may_not_leave_end_it_and_latch(scene: Search, stage: str) -> None:
    scene.servo.failing[stage] = WireRangeError("lower", 2, 9999, 0, 4095)
    scene.ask()
    [finding] = scene.findings()
    assert (finding.code, finding.joint, finding.value) == (ReasonCode.WIRE_CLAMP, KNEE, 9999.0)
    assert ReasonCode.WIRE_CLAMP in scene.rig.condition.latches


def test_a_fault_inside_the_search_ends_it_and_latches(
    scene: Search, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(EndstopSearch, "step", lambda *_: 1 / 0)
    scene.ask()
    [finding] = scene.findings()
    assert (finding.code, finding.joint) == (ReasonCode.INTERNAL, KNEE)
    assert finding.message == "ZeroDivisionError('division by zero')"
    assert scene.rig.condition.latches[ReasonCode.INTERNAL] == finding


# ------------------------------------------------------------------------------- what the joint does


@pytest.mark.parametrize(("moves", "moved"), [(4.0, 16.0), (-4.0, 16.0)])
def test_a_joint_that_does_not_stop_moving_gets_no_torque(scene: Search, moves: float, moved: float) -> None:
    scene.servo.during["prepare"] = lambda: setattr(scene.servo, "limp", lambda count: count + moves)
    scene.ask()
    [finding] = scene.findings()
    assert (finding.code, finding.joint) == (ReasonCode.STOP_NOT_FOUND, KNEE)
    assert scene.servo.log.count("prepare") == 5 and "energise" not in scene.servo.log
    assert finding.bound == 3.0 and finding.value == 5 * moved
    assert finding.message == "still moving (counts): let it hang still, then try again"


@pytest.mark.parametrize(("out", "prepared"), [(0, True), (1, False)])
@pytest.mark.parametrize("side", [-1, 1])
def test_a_joint_that_left_its_window_gets_no_goal(
    scene: Search, side: int, out: int, prepared: bool
) -> None:
    end = START + side * 40
    scene.request = scene.described(**{"lower" if side < 0 else "upper": end})
    scene.servo.during["current mode"] = lambda: setattr(scene.servo, "count", end + side * out)
    scene.servo.failing["energise"] = BROKEN
    scene.ask()
    [finding] = scene.findings()
    assert ("prepare" in scene.servo.log) == prepared
    if not prepared:
        assert (finding.code, finding.value) == (ReasonCode.STOP_NOT_FOUND, 41.0)


@pytest.mark.parametrize(("off", "allowed"), [(256, True), (257, False)])
def test_a_count_that_is_no_whole_turn_off_in_the_other_mode_ends_it(
    scene: Search, off: int, allowed: bool
) -> None:
    scene.servo.other = OTHER_MODE - off
    scene.servo.failing["prepare"] = BROKEN
    scene.request = scene.described(lower=-9000, upper=9000)
    scene.ask()
    [finding] = scene.findings()
    if allowed:
        assert finding.code == ReasonCode.BUS_ERRORS
        return
    assert (finding.code, finding.joint) == (ReasonCode.CALIB_MISMATCH, KNEE)
    assert (finding.value, finding.bound) == (257.0, TURN / 16)
    assert "prepare" not in scene.servo.log


@pytest.mark.parametrize("way", [-1, 1])
@pytest.mark.parametrize(("jump", "allowed"), [(30, True), (31, False)])
def test_a_joint_that_jumps_when_torque_comes_on_ends_it(
    scene: Search, way: int, jump: int, allowed: bool
) -> None:
    def jumps() -> None:
        scene.servo.goal_count += way * jump

    scene.servo.during["energise"] = jumps
    scene.ask()
    if allowed:
        assert scene.until_answered()["phase"] == "found"
        return
    assert scene.findings() == [
        Finding(
            ReasonCode.STOP_NOT_FOUND,
            KNEE,
            value=31.0,
            bound=30.0,
            message="counts: it jumped when torque came on",
        )
    ]
    assert len(scene.servo.goals) == 1


def test_a_stop_that_is_not_where_it_should_be_gives_no_capture(scene: Search) -> None:
    scene.servo.stop = START - 20
    scene.ask()
    [finding] = scene.findings()
    assert (finding.code, finding.joint) == (ReasonCode.STOP_NOT_FOUND, KNEE)
    assert "from where the stop should be" in finding.message


def test_a_servo_that_exceeds_its_cap_ends_it(scene: Search) -> None:
    scene.servo.strength = 2 * CAP
    scene.ask()
    [finding] = scene.findings()
    assert (finding.code, finding.joint) == (ReasonCode.OVERCURRENT, KNEE)


def test_a_loop_that_stood_still_ends_it_as_such(scene: Search) -> None:
    scene.ask()
    scene.until_moving()
    heard = scene.rig.hardware.readings.raw.heard_at.copy()
    scene.hears = False
    scene.rig.clock.sleep_until(scene.rig.clock.now() + 0.5)
    scene.rig.ticks(1)
    scene.hears = True
    assert scene.rig.hardware.readings.raw.heard_at[KNEE] == heard[KNEE]
    [finding] = scene.findings()
    assert finding.code == ReasonCode.TIME_GAP


def test_torque_that_went_off_by_itself_ends_it(scene: Search) -> None:
    scene.ask()
    scene.until_moving()
    scene.servo.torque = False
    scene.servo.limp = lambda count: count
    [finding] = scene.findings()
    assert (finding.code, finding.joint) == (ReasonCode.TORQUE_MISMATCH, KNEE)


# ------------------------------------------------------------------------------- torque off


def test_torque_off_that_is_not_confirmed_is_a_finding_and_no_capture_is_reported(scene: Search) -> None:
    scene.rig.hardware.failing["torque False"] = SILENT
    scene.ask()
    [finding] = scene.findings()
    assert (finding.code, finding.joint) == (ReasonCode.TORQUE_MISMATCH, KNEE)
    assert finding.message.startswith("torque could not be read back off: ")
    assert scene.rig.torque.unconfirmed
    [event] = [each for each in scene.rig.book.events if each.code == ReasonCode.TORQUE_MISMATCH][:1]
    assert (event.level, event.message) == ("error", finding.message)


def test_torque_off_that_is_not_confirmed_follows_what_ended_the_search(scene: Search) -> None:
    scene.rig.hardware.failing["torque False"] = SILENT
    scene.ask()
    scene.until_moving()
    scene.homing.cancel()
    found = scene.findings()
    assert [each.code for each in found] == [ReasonCode.STOP_NOT_FOUND, ReasonCode.TORQUE_MISMATCH]


def test_a_search_that_failed_stays_failed_when_its_joint_hangs_still(scene: Search) -> None:
    scene.request = scene.described(turn_unknown=True)
    scene.servo.failing["energise"] = BROKEN
    scene.ask()
    assert [each.code for each in scene.findings()] == [ReasonCode.BUS_ERRORS]
    assert scene.turns.places == {}


# ------------------------------------------------------------------------------- ended by force


def releases(scene: Search, reached: list[bool]) -> Callable[[], Procedure]:
    """A procedure that takes over; `reached`: whether torque counts as on, and as to be switched off."""

    def body() -> Procedure:
        reached.extend((scene.rig.torque.energising, scene.rig.torque.unconfirmed))
        scene.servo.torque = False
        scene.rig.torque.begin_release()
        yield
        scene.rig.torque.confirm_off()
        return None

    return body


@pytest.mark.parametrize("latched", [True, False])
@pytest.mark.parametrize("stage", ["prepare", "energise"])
def test_a_search_that_is_ended_by_force_leaves_torque_to_the_next_and_is_restored(
    scene: Search, stage: str, latched: bool
) -> None:
    scene.ask()
    scene.until_asked(stage)
    if latched:
        scene.rig.condition.latch(LATCHED)
    reached: list[bool] = []
    cleared = scene.rig.hardware.log.count("clear")
    scene.rig.own(Priority.ESTOP, releases(scene, reached))
    assert reached == [stage == "energise"] * 2
    assert scene.rig.hardware.log.count("clear") == cleared + 1
    assert scene.replies == [], "it is answered once it is restored"
    state = "the robot is calibrating: it was disarmed, or a bus was lost"
    assert scene.findings() == [LATCHED if latched else Finding(ReasonCode.NOT_ARMED, message=state)]
    assert scene.rig.outcomes == [None]


def test_a_search_that_is_ended_by_force_before_its_first_write_is_answered_at_once(scene: Search) -> None:
    scene.ask()
    scene.rig.ticks(3)
    scene.rig.condition.latch(LATCHED)
    scene.rig.own(Priority.ESTOP, releases(scene, []))
    [reply] = scene.replies
    assert reply["findings"] == [LATCHED] and reply["phase"] == "failed"
    assert scene.servo.log == ["all"]


def test_what_ended_a_search_first_is_its_reason(scene: Search) -> None:
    scene.ask()
    scene.until_moving()
    scene.homing.cancel()
    scene.until_asked("torque False")
    scene.rig.condition.latch(LATCHED)
    scene.rig.own(Priority.ESTOP, releases(scene, []))
    assert [each.code for each in scene.findings()] == [ReasonCode.STOP_NOT_FOUND]


def test_a_search_whose_bus_is_lost_before_its_first_write_is_answered(scene: Search) -> None:
    scene.ask()
    scene.rig.ticks(3)
    scene.servo.reader = scene.servo.writer = None
    scene.rig.procedures.abandon()
    assert scene.replies[0]["phase"] == "failed" and scene.homing.busy() == ""
