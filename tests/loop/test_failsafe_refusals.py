"""The fail-safe leaves robots as they are: what it finds, and the reason that it states."""

import numpy as np
import pytest

from tests.support.failsafe_steps_rig import FailsafeRig
from tests.support.procedure_rig import NAMES
from twind.loop.bus.bus_port import PortState
from twind.loop.procedures import failsafe
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode


def why(rig: FailsafeRig) -> str:
    return failsafe.why_left(rig, rig.identity)


def test_nothing_speaks_against_a_robot_that_is_whole_or_has_no_torque() -> None:
    rig = FailsafeRig()
    assert why(rig) == ""
    [devices] = rig.judged
    assert {key: device.id for key, device in devices.items()} == {
        ("lower", 1): 1,
        ("lower", 2): 2,
        ("upper", 7): 7,
    }
    rig.condition.mode = Mode.MIRROR
    rig.found((0, 0, 0))
    assert why(rig) == ""


@pytest.mark.parametrize("torque", [(-1, -1, -1), (0, 0, -1), (-1, 0, -1)])
def test_torque_that_is_not_known_of_any_joint_is_left_alone(torque: tuple[int, ...]) -> None:
    rig = FailsafeRig(torque=torque)
    names = ", ".join(name for name, known in zip(NAMES, torque, strict=True) if known < 0)
    begins = f"whether torque is on is not known of {names}: "
    assert why(rig) == begins + "no answer: power?"
    rig.hardware.ports[1].reader = None
    assert why(rig) == begins + "upper is not open"
    rig.hardware.ports[1].trouble = "no such port"
    assert why(rig) == begins + "no such port"
    rig.hardware.ports[0].reader = None
    assert why(rig) == begins + "lower is not open"


def test_torque_of_a_joint_that_is_silent_for_half_a_second_is_not_known() -> None:
    rig = FailsafeRig()
    rig.age(0.51, 0.51, 0.51)
    assert why(rig) == "whether torque is on is not known of hip, knee, toe: no answer: power?"
    rig.age(0.51, 0.51, 0.0)
    assert why(rig) == ""


def test_a_mode_that_writes_nothing_is_named() -> None:
    rig = FailsafeRig(torque=(0, 1, -1))
    rig.condition.mode = Mode.MIRROR
    assert why(rig) == "torque is on, and mode mirror of the settings writes nothing"


WRONG = Finding(ReasonCode.CALIB_MISMATCH, 1, message="another zero")
OTHER = Finding(ReasonCode.DEVICE_MISMATCH, 0, message="another model")
GONE = Finding(ReasonCode.DEVICE_MISSING, 2, message="nothing answers as id 7")


@pytest.mark.parametrize("place", ["refusals", "missing", "mismatches", "found"])
def test_a_robot_with_a_device_that_is_not_as_described_is_left_alone(place: str) -> None:
    rig = FailsafeRig()

    def find(*found: Finding) -> None:
        if place == "missing":
            rig.identity.missing["lower"] = found
        elif place == "refusals":
            rig.refusals = list(found)
        else:
            setattr(rig.verified, place, found)

    find(GONE)
    assert why(rig) == ""
    find(GONE, WRONG)
    assert why(rig) == "torque is on, and the joint positions are unknown: CALIB_MISMATCH: another zero"
    find(OTHER)
    assert why(rig) == "torque is on, and the joint positions are unknown: DEVICE_MISMATCH: another model"


def test_a_robot_whose_joints_are_not_judged_yet_is_left_alone() -> None:
    """The take-over would leave them out, and their torque would go off where they stand."""
    rig = FailsafeRig()
    rig.verified.unjudged = np.array([False, True, True])
    assert why(rig) == "torque is on, and of knee, toe the positions are not known yet"
    rig.found((1, 0, -1))
    assert why(rig) == "torque is on, and of toe the positions are not known yet"
    rig.identity.missing["lower"] = (Finding(ReasonCode.DEVICE_MISSING, message="of no joint"),)
    assert why(rig) == "torque is on, and of toe the positions are not known yet"
    rig.identity.missing["upper"] = (GONE,)
    assert why(rig) == ""


def test_a_silent_device_whose_turn_is_doubted_does_not_keep_a_carried_robot_from_being_lowered() -> None:
    """Its bus stays identified, and no identification tells more; one that runs may."""
    rig = FailsafeRig()
    rig.verified.unjudged = np.array([False, False, True])
    rig.age(0.0, 0.0, 0.1)
    assert why(rig) == "torque is on, and of toe the positions are not known yet"
    rig.age(0.0, 0.0, 0.101)
    assert why(rig) == ""
    rig.hardware.ports[0].link = PortState.IDENTIFYING
    assert why(rig) == ""
    rig.hardware.ports[1].link = PortState.IDENTIFYING
    assert why(rig) == "torque is on, and of toe the positions are not known yet"


def test_joints_of_a_closed_bus_do_not_keep_a_carried_robot_from_being_lowered() -> None:
    rig = FailsafeRig()
    rig.unplug()
    rig.verified.unjudged = np.array([False, False, True])
    assert why(rig) == ""


@pytest.mark.parametrize("support", ["gantry", "free"])
def test_a_joint_with_torque_beyond_its_hard_limit_keeps_the_robot_where_it_is(support: str) -> None:
    rig = FailsafeRig(support)
    rig.read(position=np.array([0.0, 0.1, 2.5]))
    assert why(rig) == "torque is on, and to hold toe inside the hard limits would be a step"
    rig.found((1, 1, 0))  # a limp hand gets no goal
    assert why(rig) == ""


def test_a_leg_without_torque_beyond_its_hard_limit_is_no_limp_joint() -> None:
    rig = FailsafeRig("free", torque=(1, 0, 1))
    rig.read(position=np.array([0.0, 2.5, 0.0]))
    assert why(rig) == "torque is on, and to hold knee inside the hard limits would be a step"
    rig = FailsafeRig("gantry", torque=(1, 0, 1))
    rig.read(position=np.array([0.0, 2.5, 0.0]))
    assert why(rig) == ""


STANDS = "torque is on, support is 'free', and "


def test_a_robot_that_stands_freely_is_left_alone_without_a_device() -> None:
    rig = FailsafeRig("free")
    rig.hardware.connected = False
    rig.age(0.0, 0.1, 0.0)
    assert why(rig) == STANDS + "not every device is there:  without a fresh reading"
    rig.hardware.ports[1].link = PortState.CLOSED
    rig.hardware.ports[1].trouble = "no such port"
    rig.hardware.ports[0].trouble = "of before"
    assert why(rig) == STANDS + "not every device is there: no such port"
    rig.identity.missing["upper"] = (GONE,)
    assert why(rig) == STANDS + "not every device is there: nothing answers as id 7"


def test_a_robot_that_stands_freely_is_left_alone_without_fresh_readings() -> None:
    rig = FailsafeRig("free")
    rig.age(0.0, 0.101, 0.1)
    assert why(rig) == STANDS + "not every device is there: knee without a fresh reading"
    rig.age(0.0, 0.1, 0.1)
    assert why(rig) == ""


def test_a_robot_that_stands_freely_is_left_alone_without_torque_in_a_leg() -> None:
    rig = FailsafeRig("free", torque=(1, 0, 0))
    assert why(rig) == STANDS + "it is not on in knee"
    rig.found((1, 1, 0))
    assert why(rig) == ""
    rig.found((1, 1, -1))
    assert why(rig) == STANDS + "it is not on in toe"
