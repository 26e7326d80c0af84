"""Arming on real bytes under a fake clock: what it requires, what it drops, what a failure leaves behind."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from tests.support.daemon_rig import CLIENT, MakeRig, Rig
from twind import link
from twind.loop.procedures.procedure_runner import Procedure
from twind.loop.procedures.torque_readback import torque_inherited, torque_off
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import RobotState
from twind_drivers.virtual.servo_physics import DriveState, FirstOrderPhysics

STALL = 0.06  # s: beyond the 50 ms that a reading may be old at torque-on, within the gate's 100 ms
WRITES = 8  # registers that are waiting to be written: each takes a tick at least
SPEED = 50  # counts, profile velocity; 0 as the servos start
EVERY = range(24)  # servos of the robot
FAULT = Finding(ReasonCode.INTERNAL, message="ordered by the test")


@contextmanager
def connected(*, energised: Sequence[int] = (), **options: Any) -> Iterator[Rig]:
    """A live daemon that has read every register and holds the lease; `options` are those of `Rig`.

    The servos in the rows `energised` have torque on, as a program that ended has left it.
    """
    rig = Rig(**options)
    for row in energised:
        rig.virtual["main"].servos.torque(row, True)
    try:
        rig.connect()
        rig.lease()
        yield rig
    finally:
        rig.close()


def refusal(reply: link.Reply) -> dict[str, Any]:
    """The only finding of a refused call."""
    assert reply.error == "Refused", reply
    (finding,) = reply.parameters["findings"]
    return finding


def queue_writes(rig: Rig) -> list[int]:
    """Tickets of register writes that are sent in one tick."""
    register = {"bus": "main", "name": "profile_velocity", "value": SPEED}
    return [rig.send(link.WriteRegister, id=id, **register) for id in range(1, WRITES + 1)]


def test_a_daemon_that_stalls_before_arming_arms_from_no_reading_older_than_50_ms() -> None:
    with connected() as rig:
        goals = rig.register("goal_position")
        rig.clock.sleep_until(rig.clock.now() + STALL)
        finding = refusal(rig.call(link.Arm))
        assert (finding["code"], finding["bound"]) == ("HW_DISCONNECTED", 0.05)
        assert 0.05 < finding["value"] < 0.1
        assert np.array_equal(rig.register("goal_position"), goals)
        assert not rig.register("bus_watchdog").any()
        assert not rig.register("torque_enable").any()
        assert rig.loop.condition.state is RobotState.CONNECTED


def test_a_single_joint_with_a_stale_reading_prevents_arming() -> None:
    with connected() as rig:
        rig.virtual["main"].faults.silence(5)
        rig.ticks(7)
        rig.virtual["main"].faults.silence(5, False)
        finding = refusal(rig.call(link.Arm))
        assert (finding["code"], finding["joint"]) == ("HW_DISCONNECTED", 4)
        assert not rig.register("torque_enable").any()


def test_readings_of_40_ms_are_fresh_enough_to_arm_from() -> None:
    with connected() as rig:
        rig.clock.sleep_until(rig.clock.now() + 0.03)  # beside the tick that has passed since the reading
        assert rig.call(link.Arm).error is None


def test_a_robot_found_energised_gets_no_goal_from_an_old_reading_and_keeps_its_torque() -> None:
    """With torque on, a goal at an old position is a step."""
    with connected(energised=EVERY) as rig:
        muscles = rig.virtual["main"].servos.muscles
        goals = rig.register("goal_position")
        muscles.position[0] += 100.0  # a joint that is pushed during the stall
        rig.clock.sleep_until(rig.clock.now() + STALL)
        assert refusal(rig.call(link.Arm))["code"] == "HW_DISCONNECTED"
        assert np.array_equal(rig.register("goal_position"), goals)
        assert rig.register("torque_enable").all()
        assert torque_inherited(rig.loop)


def test_a_stall_before_goals_are_chosen_ends_arming_before_torque() -> None:
    """The second look at the readings' age: devices are prepared by then, with their watchdogs armed."""
    with connected() as rig:
        ticket = rig.send(link.Arm)
        for _ in range(100):
            rig.ticks(1)
            if not rig.loop.hardware.ports[0].busy and rig.register("bus_watchdog").all():
                break
        rig.clock.sleep_until(rig.clock.now() + STALL)
        rig.ticks(30)
        assert refusal(rig.replies(ticket)[-1])["code"] == "HW_DISCONNECTED"
        assert not rig.register("torque_enable").any()
        assert not rig.loop.torque.energising


def test_register_writes_that_wait_are_dropped_when_arming_begins() -> None:
    """A write or a reboot must not reach a robot with torque."""
    with connected() as rig:
        tickets = queue_writes(rig)
        rig.ticks(1)
        assert rig.call(link.Arm).error is None
        rig.ticks(50)
        assert "dropped" in rig.replies(tickets[-1])[-1].parameters["message"]
        assert not rig.register("profile_velocity").any()


def test_register_writes_that_wait_are_dropped_when_the_arming_client_is_gone(make_rig: MakeRig) -> None:
    """Backing out of an arming that still waits for the first temperatures leaves nothing queued."""
    rig = make_rig()
    while rig.loop.condition.state is not RobotState.CONNECTED:
        rig.ticks(1)
    assert not np.isfinite(rig.loop.hardware.slow.health_time).all()
    rig.send(link.AcquireLease)
    tickets = queue_writes(rig)
    arming = rig.send(link.Arm)
    rig.ticks(1)
    assert rig.loop.hardware.ports[0].busy
    rig.front.outer.send(link.encode(link.ConnectionClosed(client=CLIENT)))
    rig.ticks(1)
    assert not rig.loop.hardware.ports[0].busy
    rig.ticks(60)
    assert rig.replies(arming)[-1].error == "Busy"
    assert all("dropped" in rig.replies(ticket)[-1].parameters["message"] for ticket in tickets)
    assert not rig.register("profile_velocity").any()


def test_disarming_in_the_middle_of_arming_leaves_nothing_that_is_written_later() -> None:
    """Disarming drops the queue of arming; torque is not on yet, so disarming itself writes nothing."""
    with connected() as rig:
        rig.send(link.Arm)
        rig.ticks(2)
        assert rig.loop.hardware.ports[0].busy
        assert rig.call(link.Disarm).parameters["state"] == "connected"
        assert not rig.loop.hardware.ports[0].busy
        before = rig.virtual["main"].servos["bus_watchdog"].copy()
        rig.seconds(1.0)
        assert np.array_equal(rig.virtual["main"].servos["bus_watchdog"], before)
        assert not rig.register("torque_enable").any()


class Slipping(FirstOrderPhysics):
    """A joint that moves as torque comes on: a horn that slipped."""

    slip = 0.0  # ticks

    def drive(self, drive: DriveState) -> None:
        """Move joint 0 by `slip` in the moment of its torque."""
        if drive.on[0] and not self._on[0]:
            self.position[0] += self.slip
        super().drive(drive)


def breaks(*_args: Any) -> Procedure:
    """A procedure whose first step raises an exception."""
    raise ZeroDivisionError
    yield


def test_an_arming_whose_first_step_fails_is_answered_once_and_owns_no_torque(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with connected() as rig:
        monkeypatch.setattr("twind.loop.procedures.arming.arm", breaks)
        ticket = rig.send(link.Arm)
        rig.ticks(5)
        [reply] = rig.replies(ticket)
        assert reply.error == "Busy" and reply.parameters["what"].startswith("failed inside")
        assert rig.loop.procedures.rank is None
        assert not rig.loop.torque.armed and not rig.loop.torque.energising


def test_a_joint_that_jumps_at_torque_on_ends_arming_with_torque_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Slipping, "slip", 200.0)
    with connected(muscles=Slipping) as rig:
        finding = refusal(rig.call(link.Arm))
        assert (finding["code"], finding["joint"], finding["bound"]) == ("ARM_FAILED", 0, 0.05)
        assert not rig.register("torque_enable").any()
        assert (rig.loop.torque.armed, rig.loop.torque.energising) == (False, False)
        assert rig.loop.condition.state is RobotState.CONNECTED


def test_a_robot_found_energised_that_fails_to_arm_keeps_its_torque() -> None:
    """Torque that was on before the call is not taken away: the robot could fall."""
    with connected(energised=EVERY) as rig:
        ticket = rig.send(link.Arm)
        rig.ticks(3)
        rig.virtual["main"].faults.silence(5)
        rig.seconds(2.0)
        assert refusal(rig.replies(ticket)[-1])["code"] == "ARM_FAILED"
        assert rig.register("torque_enable").all()
        assert not rig.loop.torque.energising


def test_a_servo_that_falls_silent_during_arming_ends_it_with_torque_off() -> None:
    with connected() as rig:
        ticket = rig.send(link.Arm)
        rig.ticks(3)
        rig.virtual["main"].faults.silence(5)
        rig.seconds(2.0)
        assert refusal(rig.replies(ticket)[-1])["code"] == "ARM_FAILED"
        rig.virtual["main"].faults.silence(5, False)
        rig.seconds(1.0)
        assert not rig.register("torque_enable").any()
        assert (rig.loop.torque.armed, rig.loop.torque.energising) == (False, False)


def test_arming_holds_every_joint_where_it_is_with_its_watchdog_set() -> None:
    with connected() as rig:
        before = rig.counts
        reply = rig.call(link.Arm)
        assert (reply.error, reply.parameters) == (None, {"joints": list(range(24))})
        assert rig.register("torque_enable").all()
        assert (rig.register("bus_watchdog") == 5).all()
        rig.seconds(0.5)
        assert rig.loop.condition.state is RobotState.ARMED
        assert np.abs(rig.counts - before).max() <= 2


def test_a_joint_beyond_either_hard_limit_is_named_with_the_bound() -> None:
    for joint, angle, bound in (("l_knee", 2.4, 2.2587), ("l_elbow", -2.35, -2.2587)):
        with connected(start={joint: angle}) as rig:
            place = rig.names.index(joint)
            finding = refusal(rig.call(link.Arm))
            assert (finding["code"], finding["joint"]) == ("OUT_OF_LIMIT", place)
            assert finding["value"] == pytest.approx(angle, abs=0.01)
            assert finding["bound"] == pytest.approx(bound)
            assert not rig.register("torque_enable").any()


def test_torque_on_in_some_joints_only_refuses_arming_and_changes_none_until_disarm() -> None:
    with connected(energised=[3]) as rig:
        finding = refusal(rig.call(link.Arm))
        assert (finding["code"], finding["joint"]) == ("ARM_FAILED", 3)
        assert np.flatnonzero(rig.register("torque_enable")).tolist() == [3]
        assert rig.call(link.Disarm, ticks=900).error is None
        assert not rig.register("torque_enable").any()


def test_a_robot_that_swings_is_not_armed() -> None:
    with connected() as rig:
        muscles = rig.virtual["main"].servos.muscles
        ticket = rig.send(link.Arm)
        for _ in range(400):
            muscles.position[7] += 4.0  # ticks in each period of 10 ms
            rig.ticks(1)
            if rig.replies(ticket):
                break
        finding = refusal(rig.replies(ticket)[-1])
        assert (finding["code"], finding["joint"], finding["bound"]) == ("ARM_FAILED", 7, 2.5)
        assert not rig.register("torque_enable").any()


def test_arming_without_the_lease_is_refused_and_writes_nothing() -> None:
    with connected() as rig:
        assert refusal(rig.call(link.Arm, client=CLIENT + 1))["code"] == "LEASE_MISSING"
        assert not rig.register("bus_watchdog").any()


def test_a_file_that_was_edited_since_the_daemon_read_it_refuses_arming() -> None:
    with connected() as rig:
        finding = refusal(rig.call(link.Arm, edited=("robot.yaml",)))
        assert finding["code"] == "CALIB_MISMATCH"
        assert "robot.yaml" in str(finding["message"])
        assert not rig.register("bus_watchdog").any()


def on_the_way(rig: Rig, *, energised: bool) -> int:
    """The ticket of an arming that has come to its last ticks, with the torque ordered on and read back."""
    ticket = rig.send(link.Arm)
    for _ in range(100):
        rig.ticks(1)
        written = rig.register("goal_position") if energised else rig.register("torque_enable")
        if rig.register("bus_watchdog").all() and written.all() and not rig.loop.hardware.ports[0].busy:
            break
    assert not rig.replies(ticket)
    assert rig.loop.condition.state is RobotState.ARMING
    return ticket


def test_torque_goes_off_when_the_arming_client_is_gone_before_arming_has_ended() -> None:
    with connected() as rig:
        on_the_way(rig, energised=False)
        rig.front.outer.send(link.encode(link.ConnectionClosed(client=CLIENT + 1)))
        rig.ticks(1)
        assert rig.register("torque_enable").all()  # another client's connection is no reason
        rig.front.outer.send(link.encode(link.ConnectionClosed(client=CLIENT)))
        rig.ticks(20)
        assert not rig.register("torque_enable").any()
        assert (rig.loop.torque.armed, rig.loop.torque.energising) == (False, False)
        assert rig.loop.condition.state is RobotState.CONNECTED


def test_a_robot_found_energised_keeps_its_torque_when_the_arming_client_is_gone() -> None:
    with connected(energised=EVERY) as rig:
        on_the_way(rig, energised=True)
        rig.front.outer.send(link.encode(link.ConnectionClosed(client=CLIENT)))
        rig.ticks(20)
        assert rig.register("torque_enable").all()
        assert (rig.loop.torque.armed, rig.loop.torque.energising, torque_inherited(rig.loop)) == (
            False,
            False,
            True,
        )


def test_a_fault_that_is_latched_before_torque_ends_arming_without_torque() -> None:
    with connected() as rig:
        ticket = rig.send(link.Arm)
        rig.ticks(2)
        rig.loop.condition.latch(FAULT)
        for _ in range(60):
            rig.ticks(1)
            assert not rig.register("torque_enable").any()
        assert refusal(rig.replies(ticket)[-1])["code"] == "ARM_FAILED"


def test_a_fault_that_is_latched_after_torque_came_on_ends_arming_with_torque_off() -> None:
    with connected() as rig:
        ticket = on_the_way(rig, energised=False)
        rig.loop.condition.latch(FAULT)
        rig.ticks(60)
        assert refusal(rig.replies(ticket)[-1])["code"] == "ARM_FAILED"
        assert not rig.register("torque_enable").any()
        assert not rig.loop.torque.energising


def test_a_servo_that_does_not_confirm_torque_off_after_a_failed_arming_is_reported() -> None:
    with connected() as rig:
        on_the_way(rig, energised=False)
        rig.virtual["main"].faults.silence(5)
        rig.loop.condition.latch(FAULT)
        rig.seconds(2.0)
        (event,) = rig.events("TORQUE_MISMATCH")
        assert rig.names[4] in event.message
        assert torque_off(rig.loop) is not True
