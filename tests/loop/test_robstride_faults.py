"""RobStride: answers to reads show no fault, so what is known of one ends with a silence."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.proof.faults.tap import Tap
from tests.proof.soak.living import robot_file
from tests.support.daemon_rig import Rig
from tests.support.derived_arm import can_arm
from twind import link
from twind.robot.modes import RobotState

OVERLOAD = 1 << 4  # bits 21 to 16 of the id of feedback: bit 20


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    """An armed arm whose first actuator reported a fault; then e-stop, reset."""
    rig = can_arm(tmp_path, "RS01")
    rig.arm()
    rig.virtual["main"].faults.damage(1, OVERLOAD)
    rig.seconds(0.5)
    assert rig.loop.condition.state is RobotState.FAULT
    assert rig.call(link.Disarm, ticks=500).error is None
    assert rig.call(link.Reset, ticks=100).error is None
    rig.lease()
    refused = rig.call(link.Arm, ticks=500)
    [finding] = refused.parameters["findings"]  # not CALIB_MISMATCH with "wait": it would wait for ever
    assert (finding["code"], finding["joint"]) == ("SERVO_ALERT", 0)
    assert "switch its power off and on" in finding["message"]
    yield rig
    rig.close()


def test_after_a_power_cycle_the_fault_is_no_longer_known_and_the_robot_is_armed(rig: Rig) -> None:
    faults = rig.virtual["main"].faults
    faults.power(False, 1)
    rig.seconds(0.3)
    assert rig.loop.hardware.slow.fault[0] == -1
    faults.power(True, 1)
    rig.seconds(1.0)
    rig.lease()
    assert rig.call(link.Arm, ticks=500).error is None
    assert rig.loop.hardware.slow.fault.tolist() == [0, 0, 0]


def test_a_fault_that_outlasts_a_silence_ends_the_next_arming(rig: Rig) -> None:
    faults = rig.virtual["main"].faults
    faults.silence(1)
    rig.seconds(0.3)
    faults.silence(1, False)
    rig.seconds(1.0)
    rig.lease()
    refused = rig.call(link.Arm, ticks=500)
    assert refused.error is not None
    rig.seconds(0.5)
    assert not any(node.shaft.on for node in rig.virtual["main"].nodes.each)


def test_a_disarm_after_one_was_silent_sets_nothing_in_those_that_hold(tmp_path: Path) -> None:
    rig = Rig(robot_file("arm-robstride", tmp_path))
    tap = Tap(rig)
    rig.arm()
    rig.lease()
    rig.virtual["main"].faults.silence(3)
    rig.seconds(0.5)
    rig.virtual["main"].faults.silence(3, False)
    rig.seconds(0.5)
    assert rig.call(link.Disarm, ticks=500).error is None
    rig.seconds(2.0)
    tap.look()
    assert tap.wrong == []
    rig.close()
