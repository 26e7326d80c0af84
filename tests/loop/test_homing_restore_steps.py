"""Restoring of a servo after an end-stop search, attempt by attempt, on a scripted bus."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.procedure_rig import ProcedureRig
from tests.support.restore_rig import KNEE, REST, TURN, WAS, OneServo, Restoring
from twind.loop.procedures import homing_restore
from twind.loop.procedures.homing_restore import EndstopSearchRecord, answer, find_end_cause
from twind.loop.procedures.procedure_runner import Priority, Procedure
from twind.robot.finding import Finding, ReasonCode
from twind.safety.multiturn import StatedPlace
from twind_drivers.bus import BusError, DeviceRefused, NoReply, WireRangeError

REFUSED = DeviceRefused("lower", 2, "Operating Mode (11)", "is locked")
LOST = NoReply("lower", (2,), 0.1)
FOUND = Finding(ReasonCode.LEASE_LOST, message="the lease is gone")


@pytest.fixture
def scene() -> Restoring:
    return Restoring()


# ------------------------------------------------------------------------------- when it is tried


def test_a_restored_servo_is_identified_before_the_caller_gets_the_captures(scene: Restoring) -> None:
    scene.begin()
    scene.seconds(0.1)
    assert scene.servo.log == ["alone", "all", "give back", "identify"]
    assert scene.restored == 1 and scene.replies == []
    scene.rig.hardware.connected = True
    scene.seconds(0.05)
    assert scene.replies == [{"phase": "found", "progress": 1.0, "ticks": [10, 12]}]
    assert scene.events() == [("info", "knee: its stop is at [10, 12]; torque is off")]
    assert scene.turns.places == {}


def test_nothing_is_written_before_the_search_is_over(scene: Restoring) -> None:
    scene.pending = replace(scene.pending, over=EndstopSearchRecord.over)
    scene.begin()
    scene.seconds(5.0)
    assert scene.servo.log == [] and scene.replies == []
    scene.pending.over = True
    scene.seconds(0.1)
    assert scene.restored == 1


def test_a_record_requires_no_reading_before_the_first_ones_agree(scene: Restoring) -> None:
    assert not scene.pending.looked_after


def waits(rank: Priority) -> Procedure:
    while True:
        yield


def obstacle(rig: ProcedureRig, servo: OneServo, name: str) -> None:
    if name in Priority.__members__:
        rig.own(Priority[name], lambda: waits(Priority[name]))
    elif name == "armed":
        rig.torque.take_hold(np.ones(3, np.bool_))
    elif name == "energising":
        rig.torque.begin_energising()
    elif name in ("writer", "reader"):
        setattr(servo, name, None)
    elif name == "device":
        servo.devices = (replace(WAS, id=3), replace(WAS, settings={}))
    else:
        setattr(servo, name, True)


@pytest.mark.parametrize(
    "name",
    [
        *(each.name for each in Priority if each is not Priority.SHUTDOWN),
        *("armed", "energising", "writer", "reader", "device", "identification", "full"),
    ],
)
def test_nothing_is_written_while_torque_a_procedure_or_the_bus_forbids_it(
    scene: Restoring, name: str
) -> None:
    obstacle(scene.rig, scene.servo, name)
    scene.begin()
    scene.seconds(2.9)
    assert scene.servo.attempts == [] and scene.replies == []
    scene.seconds(0.5)
    assert scene.codes() == [ReasonCode.DEVICE_MISMATCH]
    [finding] = scene.replies[0]["findings"]
    assert finding.joint == KNEE and finding.message == (
        "its mode and settings are not as they were: torque or bus do not allow it yet; it is tried again "
        "until they do; it is left with mode 5"
    )
    assert scene.servo.attempts == [] and scene.restored == 0


def test_an_ending_daemon_restores_it_and_replies_at_once(scene: Restoring) -> None:
    obstacle(scene.rig, scene.servo, "SHUTDOWN")
    scene.rig.condition.stop_wanted = True
    scene.begin()
    while not scene.restored:
        scene.rig.tick()
    assert not scene.rig.hardware.connected and len(scene.replies) == 1


def test_a_bus_that_is_not_identified_in_time_delays_the_reply_by_three_seconds_at_most(
    scene: Restoring,
) -> None:
    scene.begin()
    scene.seconds(2.95)
    assert scene.replies == []
    scene.seconds(0.1)
    assert scene.codes() == []


def test_a_late_restoring_is_reported_to_a_caller_that_was_answered(scene: Restoring) -> None:
    obstacle(scene.rig, scene.servo, "energising")
    scene.begin()
    scene.seconds(4.0)
    scene.rig.torque.confirm_off()
    scene.seconds(0.5)
    assert scene.restored == 1 and len(scene.replies) == 1
    assert scene.events()[-1] == ("info", "knee: its mode and settings are as they were")
    assert scene.servo.log[-1] == "identify"


# ------------------------------------------------------------------------------- what ends it


@pytest.mark.parametrize("error", [REFUSED, ValueError("no mode 5"), KeyError("led")])
def test_three_refusals_end_the_restoring(scene: Restoring, error: Exception) -> None:
    scene.servo.errors = [error] * 5
    scene.begin()
    scene.seconds(2.0)
    first, second, third = scene.servo.attempts
    assert second - first >= 0.25 and third - second >= 0.25
    scene.rig.hardware.connected = True
    scene.seconds(0.1)
    assert scene.codes() == [ReasonCode.DEVICE_MISMATCH] and scene.restored == 1
    assert str(error) in scene.replies[0]["findings"][0].message
    assert scene.replies[0]["phase"] == "failed" and "ticks" not in scene.replies[0]
    [(level, text), (_, last)] = scene.events()
    assert level == "error" and text.startswith("knee: its mode and settings are not as they were: ")
    assert last.startswith("knee: its stop was not found: ")


def test_two_refusals_do_not_end_it(scene: Restoring) -> None:
    scene.servo.errors = [REFUSED] * 2
    scene.begin()
    scene.seconds(1.0)
    assert len(scene.servo.attempts) == 3 and scene.restored == 1
    scene.rig.hardware.connected = True
    scene.seconds(0.1)
    assert scene.codes() == []


@pytest.mark.parametrize("error", [LOST, BusError("dropped")])
def test_attempts_that_were_cut_short_are_repeated_without_end(scene: Restoring, error: BusError) -> None:
    scene.servo.errors = [error] * 30
    scene.begin()
    scene.seconds(8.0)
    assert scene.restored == 0 and len(scene.servo.attempts) == 30
    assert scene.codes() == [ReasonCode.DEVICE_MISMATCH]
    scene.seconds(0.5)
    assert scene.restored == 1


def test_bytes_that_may_not_leave_latch_and_end_it(scene: Restoring) -> None:
    scene.servo.errors = [WireRangeError("lower", 2, 9, 0, 4)]
    scene.begin()
    scene.seconds(0.1)
    scene.rig.hardware.connected = True
    scene.seconds(0.1)
    assert scene.codes() == [ReasonCode.WIRE_CLAMP, ReasonCode.DEVICE_MISMATCH]
    clamp, left = scene.replies[0]["findings"]
    assert (clamp.joint, clamp.value) == (KNEE, 9.0) and "packet not sent" in clamp.message
    assert "packet not sent" in left.message and scene.restored == 1
    assert ReasonCode.WIRE_CLAMP in scene.rig.condition.latches


@pytest.mark.parametrize(
    ("other", "text"),
    [
        ({"model_number": 1030}, "model was 1020, reads 1030"),
        ({"firmware": 44}, "firmware was 45, reads 44"),
        ({"unique_id": "b"}, "unique id was a, reads b"),
        ({"settings": {"drive_mode": 1, "homing_offset": 3}}, "drive_mode was 0, reads 1"),
        ({"settings": {"drive_mode": 0, "homing_offset": 4}}, "homing_offset was 3, reads 4"),
    ],
)
def test_another_device_with_its_id_gets_nothing(scene: Restoring, other: Any, text: str) -> None:
    scene.servo.devices = (replace(WAS, **other),)
    scene.begin()
    scene.seconds(0.1)
    assert scene.servo.log == ["identify"] and scene.restored == 1
    scene.rig.hardware.connected = True
    scene.seconds(0.1)
    [finding] = scene.replies[0]["findings"]
    assert f"another device has its id now ({text}): nothing was written" in finding.message


def test_findings_of_the_search_precede_those_of_the_restoring() -> None:
    scene = Restoring(findings=(FOUND,))
    scene.servo.errors = [REFUSED] * 3
    scene.begin()
    scene.seconds(1.0)
    scene.rig.hardware.connected = True
    scene.seconds(0.1)
    assert scene.codes() == [ReasonCode.LEASE_LOST, ReasonCode.DEVICE_MISMATCH]
    assert scene.events()[-1] == ("warning", "knee: its stop was not found: the lease is gone")
    assert scene.rig.book.events[-1].code == ReasonCode.LEASE_LOST
    assert scene.replies[0]["progress"] == 1.0


# ------------------------------------------------------------------------------- the turn of its rest


def resting(**how: Any) -> Restoring:
    """A search that determined the turn; its bus is identified at once."""
    scene = Restoring(rest=REST, **how)
    scene.servo.identify = lambda: scene.servo.log.append("identify")  # type: ignore[method-assign]
    return scene


@pytest.mark.parametrize("turns", [-2, 0, 1])
def test_a_joint_that_stays_at_its_rest_keeps_the_turn_that_was_found(turns: int) -> None:
    scene = resting()
    scene.count = REST + turns * TURN + 32
    scene.begin()
    scene.seconds(0.5)
    assert scene.turns.places == {KNEE: StatedPlace(REST, 32, "the end-stop search")}
    assert scene.codes() == [] and scene.turns.withdrawn == [[KNEE]]


def moved_a_turn(scene: Restoring) -> None:
    for step in range(1, 9):
        scene.count = REST + step * TURN // 8
        scene.rig.tick()


def silent(scene: Restoring) -> None:
    last = scene.rig.clock.now()
    scene.heard = lambda _: last
    scene.seconds(0.12)
    scene.heard = lambda now: now


@pytest.mark.parametrize("leaves", [moved_a_turn, silent])
def test_a_joint_that_left_its_rest_before_the_restoring_gets_no_turn_although_its_count_fits_again(
    leaves: Callable[[Restoring], None],
) -> None:
    scene = resting()
    scene.servo.errors = [LOST] * 3
    scene.begin()
    scene.seconds(0.1)
    leaves(scene)
    scene.seconds(2.0)
    assert scene.restored == 1 and scene.turns.places == {}
    assert scene.codes() == [ReasonCode.CALIB_MISMATCH]
    [finding] = scene.replies[0]["findings"]
    assert finding.joint == KNEE and "its turn stays unknown" in finding.message


@pytest.mark.parametrize("read", [True, False])
def test_only_a_joint_that_was_read_until_it_came_to_rest_gets_a_turn(read: bool) -> None:
    scene = resting()
    scene.pending.over = False
    scene.begin()
    scene.seconds(0.1)
    if not read:
        silent(scene)
    scene.seconds(0.1)
    scene.pending.over = True
    scene.seconds(0.5)
    assert scene.codes() == ([] if read else [ReasonCode.CALIB_MISMATCH])
    assert bool(scene.turns.places) == read


def test_a_joint_whose_last_reading_is_of_the_last_tenth_of_a_second_rests() -> None:
    scene = resting()
    scene.heard = lambda now: now - 0.099
    scene.begin()
    scene.seconds(0.5)
    assert scene.codes() == []


def test_a_place_that_contradicts_the_readings_gives_no_turn() -> None:
    scene = resting()
    scene.turns.against = Finding(ReasonCode.CALIB_MISMATCH, KNEE, message="stands aside")
    scene.begin()
    scene.seconds(0.1)
    assert scene.replies[0]["findings"] == [scene.turns.against]
    assert scene.turns.withdrawn == [[KNEE]]


@pytest.mark.parametrize(("takes", "codes"), [(24, []), (60, [ReasonCode.CALIB_MISMATCH])])
def test_readings_have_a_quarter_of_a_second_to_choose_the_turn(takes: int, codes: list[str]) -> None:
    scene = resting()
    scene.turns.takes = takes
    scene.begin()
    scene.seconds(1.0)
    assert scene.codes() == codes and scene.turns.withdrawn == [[KNEE]]


def test_an_answered_caller_hears_of_a_servo_that_is_not_restored_alone(scene: Restoring) -> None:
    scene.pending.answered = True
    scene.servo.errors = [REFUSED] * 3
    scene.begin()
    scene.seconds(1.0)
    assert [level for level, _ in scene.events()] == ["error"]


@pytest.mark.parametrize("why", ["refused", "answered"])
def test_no_turn_is_chosen_for_a_servo_that_is_not_restored_or_a_caller_that_was_answered(why: str) -> None:
    scene = resting(answered=why == "answered")
    scene.servo.errors = [REFUSED] * (3 if why == "refused" else 0)
    scene.begin()
    scene.seconds(1.0)
    assert scene.restored == 1 and scene.turns.places == {}
    assert any("are as they were" in text for _, text in scene.events()) is (why == "answered")


# ------------------------------------------------------------------------------- what is reported


def test_a_search_is_answered_once(scene: Restoring) -> None:
    answer(scene.rig, scene.pending)
    answer(scene.rig, scene.pending, FOUND)
    assert scene.codes() == []


def test_a_daemon_that_ends_reports_what_is_left(scene: Restoring) -> None:
    homing_restore.report_pending_restore(scene.rig, scene.pending)
    [finding] = scene.replies[0]["findings"]
    assert finding.code == ReasonCode.DEVICE_MISMATCH
    assert finding.message == (
        "its mode and settings are not as they were: the daemon ends; it is left with mode 5"
    )
    assert scene.events()[0] == ("error", f"knee: {finding.message}")


def test_the_cause_of_an_end_from_outside_is_a_latch_the_end_of_the_daemon_or_the_state(
    scene: Restoring,
) -> None:
    condition = scene.rig.condition
    text = "the robot is calibrating: it was disarmed, or a bus was lost"
    assert find_end_cause(scene.rig) == Finding(ReasonCode.NOT_ARMED, message=text)
    condition.stop_wanted = True
    assert find_end_cause(scene.rig) == Finding(ReasonCode.NOT_ARMED, message="the daemon ends")
    condition.latch(FOUND)
    assert find_end_cause(scene.rig) == FOUND
