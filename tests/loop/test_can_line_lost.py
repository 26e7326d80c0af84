"""A CAN bus without acknowledgement (CAN_BUS_STATE): the loop empties and leaves it, others follow support.

Serial servos stand in for CAN actuators: what their controller says of the line is added to what they answer.
"""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.robot.modes import RobotState
from twind_drivers.bus import BusSample

pytestmark = pytest.mark.slow  # whole lives of the loop: half of all fast tests' time

ACTIVE = 0
PASSIVE = 1
OFF = 2


class Can(Rig):
    """A robot whose guard takes the upper bus for a CAN bus; `line` is what its controller says."""

    line = ACTIVE

    def __init__(self, support: str = "gantry") -> None:
        super().__init__("h24-split", support=support)
        can = {bus.name: bus.joints.tolist() for bus in self.loop.robot.joints.buses if bus.name == "upper"}
        guard = self.loop.parts.guard
        guard.__init__(  # type: ignore[misc]
            self.loop.robot.limits,
            buses=[bus.name for bus in self.loop.robot.joints.buses],
            can=can,
            support=support,
            ratings=self.loop.robot.description.ratings,
        )
        port = self.port
        finish = port.finish

        def finish_with_line(now: float) -> BusSample | None:
            sample = finish(now)
            return replace(sample, line=self.line) if sample is not None else None

        port.finish = finish_with_line  # type: ignore[method-assign]
        self.arm()
        self.submit(self.path("l_elbow", [-0.6], [2.0]))
        self.seconds(0.5)

    @property
    def port(self):  # type: ignore[no-untyped-def]
        return next(port for port in self.loop.hardware.ports if port.name == "upper")

    def goals(self, bus: str) -> list[int]:
        return [int(goal) for goal in self.virtual[bus].servos["goal_position"]]


def latched(rig: Rig) -> set[str]:
    return {str(code) for code in rig.loop.condition.latches}


def test_a_passive_line_is_reported_and_the_motion_continues(make_rig: MakeRig) -> None:
    rig = make_rig(kind=Can)
    rig.line = PASSIVE
    rig.seconds(0.5)
    assert len(rig.events("CAN_BUS_STATE")) == 1
    assert rig.loop.condition.state is RobotState.ARMED
    assert not rig.loop.condition.latches
    assert rig.loop.executor.motion.value == "active"


@pytest.mark.parametrize("support", ["fixed", "gantry"])
def test_a_bus_that_is_off_gets_nothing_more_and_the_others_hold(make_rig: MakeRig, support: str) -> None:
    rig = make_rig(support, kind=Can)
    rig.line, before = OFF, rig.goals("upper")
    rig.ticks(2)
    told = rig.goals("upper")
    assert {"CAN_BUS_STATE", "PORT_LOST"} <= latched(rig)
    assert rig.loop.condition.state is RobotState.FAULT
    rig.line = ACTIVE
    rig.seconds(3.0)
    assert rig.goals("upper") == told  # one tick's step at most, and no more
    assert np.abs(np.subtract(told, before)).max() < 40
    assert rig.loop.torque.armed is True
    assert all(rig.virtual["lower"].servos["torque_enable"])
    assert rig.loop.hardware.connected  # opened anew, everybody identified, nothing moves by itself
    assert not rig.port.holding


def test_a_lost_line_recovers_only_by_disarm_reset_and_arm(make_rig: MakeRig) -> None:
    rig = make_rig(kind=Can)
    rig.line = OFF
    rig.ticks(3)
    rig.line = ACTIVE
    rig.seconds(2.0)
    rig.lease()
    assert rig.call(link.Arm).error is not None
    rig.call(link.Disarm, ticks=1200)
    assert (rig.register("torque_enable") == 0).all()
    rig.call(link.Reset)
    rig.lease()
    assert rig.call(link.Arm).error is None


def test_a_robot_that_stands_freely_is_lowered_by_the_others_and_let_go(make_rig: MakeRig) -> None:
    rig = make_rig("free", kind=Can)
    rig.line = OFF
    rig.seconds(10.0)
    assert rig.loop.torque.armed is False
    assert not any(rig.virtual["lower"].servos["torque_enable"])
    assert "CAN_BUS_STATE" in latched(rig)


@pytest.mark.parametrize("support", ["gantry", "free"])
def test_a_bus_that_stays_silent_is_given_up_once(make_rig: MakeRig, support: str) -> None:
    """Given up again and again it would stop the way down of the others each time."""
    rig = make_rig(support, kind=Can)
    for id in rig.virtual["upper"].servos["id"]:
        rig.virtual["upper"].faults.silence(int(id))
    rig.seconds(11.0 if support == "free" else 2.0)
    assert len(rig.events("PORT_LOST")) == 1
    assert rig.port.reader is not None  # open again, and asked
    assert any(rig.virtual["lower"].servos["torque_enable"]) is (support == "gantry")


def test_silence_of_a_whole_bus_is_the_same_after_100_ms(make_rig: MakeRig) -> None:
    rig = make_rig(kind=Can)
    for id in rig.virtual["upper"].servos["id"]:
        rig.virtual["upper"].faults.silence(int(id))
    begun = rig.clock.now()
    while "CAN_BUS_STATE" not in latched(rig) and rig.clock.now() < begun + 1.0:
        rig.ticks(1)
    assert 0.09 <= rig.clock.now() - begun <= 0.121
    assert rig.port.reader is None


def test_a_line_that_is_off_bars_arming(make_rig: MakeRig) -> None:
    rig = make_rig(kind=Can)
    rig.call(link.Disarm, ticks=1200)
    rig.line = OFF
    rig.ticks(3)
    assert rig.loop.hardware.connected  # nobody is held up by it: it is told, and no more
    assert rig.loop.condition.state is RobotState.CONNECTED
    rig.lease()
    refused = rig.call(link.Arm)
    assert [finding["code"] for finding in refused.parameters["findings"]] == ["CAN_BUS_STATE"]
    rig.line = ACTIVE
    rig.ticks(2)
    rig.lease()
    assert rig.call(link.Arm).error is None


def test_a_line_that_goes_off_while_arming_ends_the_arming(make_rig: MakeRig) -> None:
    rig = make_rig(kind=Can)
    rig.call(link.Disarm, ticks=1200)
    rig.lease()
    rig.send(link.Arm)
    rig.ticks(3)
    assert rig.loop.condition.state is RobotState.ARMING
    rig.line = OFF
    rig.ticks(3)
    assert "CAN_BUS_STATE" in latched(rig)
    rig.line = ACTIVE
    rig.seconds(12.0)
    assert rig.loop.torque.armed is False
    assert not any(rig.virtual["lower"].servos["torque_enable"])
