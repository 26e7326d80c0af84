"""A robot whose ankle two actuators turn, one of them silent: what its mate does while torque goes off."""

from pathlib import Path

import numpy as np
import pytest

from tests.support import transmission_robot_file as linked
from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.robot.modes import Mode

MATE, SILENT = 5, 6
BENT = {"knee": 1.0, "ankle_pitch": -0.3, "ankle_roll": 0.1, "waist_roll": 0.2, "waist_yaw": -0.3}


@pytest.fixture
def rig(make_rig: MakeRig, tmp_path: Path) -> Rig:
    made: Rig = make_rig(str(linked.write(tmp_path)), start=BENT)
    return made


def place(rig: Rig, id: int) -> float:
    """Position of that actuator, ticks."""
    rig.advance_servos()
    leg = rig.virtual["leg"].servos
    return float(leg.muscles.position[list(leg["id"]).index(id)])


def found_on(rig: Rig, limp: int | None = None) -> None:
    """Its daemon was killed, and another one has identified the robot; an actuator may be without torque."""
    rig.arm()
    rig.loop.hardware.access(read=False, write=False)
    rig.front.end(0.0)
    rig.front = rig.new_front()
    rig.clock.sleep_until(rig.clock.now() + 0.5)
    rig.advance_servos()
    leg = rig.virtual["leg"].servos
    if limp is not None:
        leg.torque(list(leg["id"]).index(limp), False)
    rig.loop = rig.born(Mode.LIVE)
    rig.connect()


def lowered_but_for_the_mate(rig: Rig, before: float, stop: type[link.Command]) -> None:
    """The knee comes to its rest pose; the mate stays at the count `before`."""
    rig.send(stop)
    moved = 0.0
    for _ in range(500):
        rig.ticks(1)
        moved = max(moved, abs(place(rig, MATE) - before))
    assert moved <= 2
    knee = rig.names.index("knee")
    assert abs(rig.truth[knee] - rig.loop.robot.rest[knee]) < 0.02


@pytest.mark.parametrize("armed", [True, False])
@pytest.mark.parametrize("stop", [link.Disarm, link.EStop])
def test_of_two_actuators_that_turn_a_joint_none_is_driven_while_the_other_is_silent(
    rig: Rig, armed: bool, stop: type[link.Command]
) -> None:
    """Alone it would turn both joints elsewhere than to the rest pose."""
    if armed:
        rig.arm()
    else:
        found_on(rig)
    before = place(rig, MATE)
    rig.virtual["leg"].faults.silence(SILENT)
    rig.seconds(0.3)
    lowered_but_for_the_mate(rig, before, stop)
    [event] = [each for each in rig.events("DEVICE_MISSING") if "stay where they are" in each.message]
    assert event.message.startswith("ankle_roll, ankle_pitch stay")
    answering = np.array([id != SILENT for bus in rig.virtual.values() for id in bus.servos["id"]])
    assert not rig.register("torque_enable")[answering].any()


def test_of_two_actuators_that_turn_a_joint_none_is_driven_while_the_other_is_without_torque(
    rig: Rig,
) -> None:
    found_on(rig, limp=SILENT)
    before = place(rig, MATE)
    lowered_but_for_the_mate(rig, before, link.Disarm)
    assert not rig.register("torque_enable").any()
    assert rig.events("TORQUE_MISMATCH") == []
