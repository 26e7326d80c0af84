"""CAN actuators that report their torque only after an order, in a whole daemon: all torque off is sent."""

from pathlib import Path

import pytest

from tests.support.calibration_rig import restarted
from tests.support.daemon_rig import Rig
from tests.support.derived_arm import can_arm
from twind import link
from twind.robot.modes import Mode
from twind.safety.device_rules import LOST_MASTER

DEVICES = pytest.mark.parametrize("device", ["AK70-10", "DM4310"])


def armed_arm(folder: Path, device: str) -> Rig:
    rig = can_arm(folder, device)
    rig.arm()
    rig.lease()
    return rig


def reported(rig: Rig) -> list[int]:
    return [int(each) for each in rig.loop.hardware.slow.torque]


def energised(rig: Rig) -> bool:
    return any(node.shaft.on for node in rig.virtual["main"].nodes.each)


@DEVICES
@pytest.mark.parametrize("level", ["settle", "cut"])
def test_an_e_stop_of_a_bus_that_is_away_is_done_when_it_returns(
    tmp_path: Path, device: str, level: str
) -> None:
    rig = armed_arm(tmp_path, device)
    rig.virtual["main"].faults.unplug()
    rig.seconds(0.3)
    rig.send(link.EStop, level=level)
    rig.seconds(0.3)
    rig.virtual["main"].faults.replug()
    rig.seconds(3.0)
    assert not energised(rig)
    assert reported(rig) == [0, 0, 0]
    rig.close()


@DEVICES
def test_an_actuator_that_missed_its_torque_off_gets_it_when_it_answers(tmp_path: Path, device: str) -> None:
    rig = armed_arm(tmp_path, device)
    rig.virtual["main"].faults.silence(2)
    assert rig.call(link.Disarm, ticks=2000).error == "BusFailed"
    rig.virtual["main"].faults.silence(2, False)
    rig.seconds(3.0)
    assert not energised(rig)
    assert reported(rig) == [0, 0, 0]
    rig.close()


@DEVICES
def test_a_daemon_that_ends_switches_off_a_bus_that_is_back_but_not_identified(
    tmp_path: Path, device: str
) -> None:
    rig = armed_arm(tmp_path, device)
    rig.virtual["main"].faults.unplug()
    rig.seconds(0.3)
    rig.loop.condition.stop_wanted = True
    rig.seconds(0.3)
    rig.virtual["main"].faults.replug()
    for _ in range(400):
        if not rig.loop.condition.finished:
            rig.ticks(1)
    assert rig.loop.condition.finished
    assert not energised(rig)
    rig.close()


def test_actuators_that_lost_their_master_while_no_daemon_ran_are_armed(tmp_path: Path) -> None:
    """Their tripped watchdog reads as an error, and is none: arming clears it."""
    rig = armed_arm(tmp_path, "DM4310")
    rig.virtual["main"].faults.unplug()
    rig.clock.time += 0.5
    rig.virtual["main"].faults.replug()
    restarted(rig, rig.calibration, Mode.LIVE)
    assert rig.loop.hardware.slow.fault.tolist() == [LOST_MASTER] * 3
    rig.lease()
    assert rig.call(link.Arm, ticks=600).error is None
    assert energised(rig)
    rig.close()
