"""The humanoid with legs on CAN and the rest on a serial bus, in process: real bytes, a fake clock."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from tests.support.described_robot import redescribe
from tests.support.mujoco_servo_rig import WholeBodyRig
from twind import link
from twind.robot.arrays import Floats
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, RobotState
from twind.robot.trajectory import Trajectory

LEGS = ("l_leg", "r_leg")


@pytest.fixture
def mixed(make_rig: MakeRig) -> Rig:
    rig: Rig = make_rig("h24-mixed")
    return rig


def nodes(rig: Rig, bus: str) -> list[dict[str, Any]]:
    """Return the true state of a leg's actuators."""
    found: list[dict[str, Any]] = rig.virtual[bus].truth(rig.clock.now())
    return found


def on(rig: Rig, bus: str) -> list[bool]:
    """Return the torque of each device."""
    if bus in LEGS:
        return [bool(node["torque"]) for node in nodes(rig, bus)]
    return [bool(torque) for torque in rig.virtual[bus].servos["torque_enable"]]


def places(rig: Rig, bus: str) -> list[int]:
    """The joints of a bus."""
    return [place for place, joint in enumerate(rig.robot.joints) if joint.bus == bus]


def demonstration(rig: Rig, name: str) -> Trajectory:
    """One of the motions that come with the robot."""
    written = json.loads((rig.robot.motions / f"{name}.json").read_text())
    mine = [rig.names.index(joint) for joint in written["joint_names"]]

    def column(key: str) -> Floats | None:
        if key not in written["points"][0]:
            return None
        rows = np.zeros((len(written["points"]), len(rig.names)))
        rows[:, mine] = [point[key] for point in written["points"]]
        return rows

    commanded = np.zeros(len(rig.names), np.bool_)
    commanded[mine] = True
    position = column("positions")
    assert position is not None
    time = np.array([point["time_from_start"] for point in written["points"]])
    return Trajectory(time, position, commanded, column("velocities"), column("accelerations"))


def test_all_three_buses_are_identified_and_nothing_stands_between_them_and_arming(mixed: Rig) -> None:
    mixed.connect()
    assert mixed.loop.identity.troubles == []
    assert [len(port.devices) for port in mixed.loop.hardware.ports] == [12, 6, 6]
    mixed.ticks(5)
    assert mixed.loop.robot.measured.heard.all()
    assert np.abs(mixed.loop.robot.measured.position).max() < 0.002  # it hangs in its rest pose
    assert not any(any(on(mixed, bus)) for bus in mixed.virtual)


def test_arming_energises_every_joint_with_its_watchdog_and_moves_none(mixed: Rig) -> None:
    mixed.connect()
    before = mixed.truth
    mixed.arm()
    assert all(all(on(mixed, bus)) for bus in mixed.virtual)
    assert all(node["watchdog"] > 0 for bus in LEGS for node in nodes(mixed, bus))
    mixed.seconds(1.0)
    assert np.abs(mixed.truth - before).max() < 0.002
    assert mixed.loop.condition.state is RobotState.ARMED


def test_a_leg_with_a_displaced_zero_is_not_armed(mixed: Rig) -> None:
    mixed.virtual["l_leg"].faults.zero_lost(4, -2.0)
    mixed.connect()
    mixed.call(link.AcquireLease)
    refused = mixed.call(link.Arm)
    assert refused.error == "Refused"
    [finding] = [each for each in refused.parameters["findings"] if each["code"] == ReasonCode.CALIB_MISMATCH]
    assert finding["joint"] == mixed.names.index("l_knee")
    assert "neither that nor a turn beside it is in its travel" in finding["message"]
    assert not any(any(on(mixed, bus)) for bus in mixed.virtual)
    mixed.virtual["l_leg"].faults.zero_lost(4, 2.0)
    mixed.seconds(0.1)
    assert mixed.call(link.Arm).error is None


@pytest.mark.parametrize("turns", [-1, 1])
def test_a_leg_that_woke_up_a_turn_off_is_put_right_and_driven_where_it_is(mixed: Rig, turns: int) -> None:
    knee = mixed.names.index("l_knee")
    mixed.virtual["l_leg"].faults.zero_lost(4, 2.0 * np.pi * turns)
    mixed.arm()
    assert mixed.loop.hardware.readings.shift[knee] == -turns * 16384
    assert abs(mixed.loop.robot.measured.position[knee]) < 0.002
    before = nodes(mixed, "l_leg")[3]["position"]
    mixed.submit(mixed.path("l_knee", [0.2], [1.0]))
    mixed.seconds(2.0)
    assert mixed.loop.robot.measured.position[knee] == pytest.approx(0.2, abs=0.01)
    assert abs(nodes(mixed, "l_leg")[3]["position"] - before) < 3000  # 0.2 rad, not a turn
    assert mixed.loop.condition.latches == {}


def test_a_leg_two_turns_off_has_no_goals_there_and_is_refused(mixed: Rig) -> None:
    mixed.virtual["l_leg"].faults.zero_lost(4, 4.0 * np.pi)
    mixed.connect()
    [finding] = mixed.loop.identity.troubles
    assert finding.joint == mixed.names.index("l_knee")
    assert "2 turns from where it was calibrated; its goals there" in finding.message


def test_actuators_without_a_readable_watchdog_are_reported_at_every_arming(make_rig: MakeRig) -> None:
    rig = make_rig("h24-mixed")
    knee = rig.names.index("l_knee")
    redescribe(rig.loop, joints=replace(rig.loop.robot.joints, unwatched=(knee,)))
    for count in (1, 2):
        rig.arm()
        told = [
            event
            for event in rig.events(ReasonCode.DEVICE_MISMATCH)
            if "without a device watchdog" in event.message
        ]
        assert [[each.joint for each in event.findings] for event in told] == [[knee]] * count
        assert rig.call(link.Disarm, ticks=1200).error is None
    rig.call(link.AcquireLease)
    warnings = rig.call(link.Arm).parameters["warnings"]
    assert [(each["code"], each["joint"]) for each in warnings] == [("DEVICE_MISMATCH", knee)]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["reach", "squat", "wave"])
def test_the_demonstration_motions_run_with_all_joints_of_a_body_that_weighs(
    make_rig: MakeRig, name: str
) -> None:
    rig = make_rig("h24-mixed", kind=WholeBodyRig)
    rig.arm()
    path = demonstration(rig, name)
    ticket = rig.submit(path, more=True)
    worst = np.zeros(len(rig.names))
    before = None
    for _ in range(round((path.time[-1] + 1.0) / rig.loop.robot.period)):
        rig.ticks(1)
        reference = rig.loop.executor.reference
        assert reference is not None
        if before is not None:  # what was sent a tick ago is read now
            worst = np.maximum(worst, np.abs(rig.loop.robot.measured.position - before))
        before = reference.position.copy()
    assert rig.replies(ticket)[-1].parameters["phase"] == "succeeded"
    assert rig.loop.condition.state is RobotState.ARMED
    legs = [place for bus in LEGS for place in places(rig, bus)]
    assert worst[legs].max() < 0.02, rig.names[legs[int(worst[legs].argmax())]]
    assert worst.max() < 0.06, rig.names[int(worst.argmax())]
    if name == "squat":
        assert np.ptp(path.position[:, legs], axis=0).max() > 0.5


def test_disarming_lowers_all_and_takes_all_torque(mixed: Rig) -> None:
    mixed.arm()
    mixed.submit(mixed.path("l_knee", [0.6], [1.0]))
    mixed.seconds(1.5)
    assert mixed.truth[mixed.names.index("l_knee")] == pytest.approx(0.6, abs=0.02)
    assert mixed.call(link.Disarm, ticks=1200).error is None
    assert not any(any(on(mixed, bus)) for bus in mixed.virtual)
    assert np.abs(mixed.truth).max() < 0.05
    assert mixed.loop.condition.state is RobotState.CONNECTED


@pytest.mark.slow
def test_an_unplugged_leg_latches_and_the_others_hold_until_disarm(mixed: Rig) -> None:
    mixed.arm()
    mixed.submit(mixed.path("r_knee", [0.6], [1.0]))
    mixed.seconds(0.5)
    mixed.virtual["l_leg"].faults.unplug()
    mixed.seconds(3.0)
    assert mixed.loop.condition.state is RobotState.FAULT
    assert "PORT_LOST" in mixed.loop.condition.latches
    lost = places(mixed, "l_leg")
    heard = mixed.loop.robot.measured.heard
    assert not heard[lost].any()
    assert heard[[place for place in range(len(heard)) if place not in lost]].all()
    knee = mixed.names.index("r_knee")
    stopped = mixed.truth[knee]
    assert 0.05 < stopped < 0.59
    assert all(on(mixed, "r_leg"))
    assert all(on(mixed, "upper"))
    mixed.seconds(5.0)
    assert mixed.truth[knee] == pytest.approx(stopped, abs=0.01)
    assert not any(on(mixed, "l_leg")) or all(node["tripped"] for node in nodes(mixed, "l_leg"))
    mixed.virtual["l_leg"].faults.replug()
    mixed.seconds(3.0)
    assert mixed.loop.hardware.connected
    assert mixed.loop.condition.state is RobotState.FAULT
    assert mixed.call(link.Disarm, ticks=1500).error is None
    assert not any(any(on(mixed, bus)) for bus in mixed.virtual)
    mixed.call(link.Reset)
    mixed.seconds(0.5)  # the leg had its watchdog tripped: once all is down it is asked anew who it is
    mixed.lease()
    assert mixed.call(link.Arm).error is None


def test_a_mirror_of_it_reads_all_and_writes_no_leg(make_rig: MakeRig) -> None:
    rig = make_rig("h24-mixed", Mode.MIRROR)
    rig.connect()
    rig.seconds(1.0)
    assert rig.loop.robot.measured.heard.all()
    assert all(port.writer is None for port in rig.loop.hardware.ports)
    assert all(node["watchdog"] == 0 and not node["torque"] for bus in LEGS for node in nodes(rig, bus))
