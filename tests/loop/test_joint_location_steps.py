"""Turns of joints by a stated pose, tick by tick, without buses."""

from collections.abc import Sequence
from dataclasses import replace
from math import nan
from typing import Any

import numpy as np
import pytest

from tests.support.procedure_rig import PERIOD, ProcedureRig
from twind import link
from twind.loop.procedures.joint_location import JointLocation
from twind.robot.finding import Finding, ReasonCode
from twind.safety.lease import Lease
from twind.safety.multiturn import StatedPlace
from twind.safety.state_machine import RobotEvent

CLIENT, OTHER = 7, 9
TURN = 4096
ASIDE = Finding(ReasonCode.CALIB_MISMATCH, 1, message="stands aside")


class Turns:
    """Turns of three joints: known where a test says so."""

    def __init__(self) -> None:
        self.turn_known = np.zeros(3, np.bool_)
        self.places: dict[int, StatedPlace] = {}
        self.against: dict[int, Finding] = {}
        self.refused: list[Finding] = []
        self.waits = True
        self.withdrawn: list[list[int]] = []

    def locate(self, joint: int, place: StatedPlace) -> Finding | None:
        self.places[joint] = place
        return self.against.get(joint)

    def withdraw(self, joints: Sequence[int]) -> None:
        self.withdrawn.append(list(joints))

    def refused_turns(self, joints: Sequence[int]) -> list[Finding]:
        return [each for each in self.refused if each.joint in joints]

    def waiting(self, joints: Sequence[int]) -> bool:
        assert list(joints) in ([1], [1, 2])
        return self.waits


class Scene:
    """A robot that is calibrated, without torque; one client holds the lease."""

    def __init__(self) -> None:
        self.rig = rig = ProcedureRig()
        self.lease = Lease()
        self.lease.acquire(CLIENT, "ann", 0, rig.clock.now())
        rig.condition.change(RobotEvent.CALIBRATE)
        rig.book.events.clear()
        buses: Any = rig.robot.joints.buses
        for bus, zero, scale in ((buses[0], [2000, 100], [0.001, 0.002]), (buses[1], [50], [-0.004])):
            bus.zero, bus.scale = np.array(zero), np.array(scale)
        rig.robot.bound.file.joints[0].type.ticks_per_turn = TURN
        self.turns = Turns()
        self.location = JointLocation(rig, self.lease, self.turns)  # type: ignore[arg-type]

    def ask(self, *joints: int, client: int = CLIENT, positions: Sequence[float] = (0.5, -0.2)) -> None:
        command = link.LocateJoints(
            ticket=4,
            client=client,
            holder="ann",
            joints=list(joints),
            positions=list(positions)[: len(joints)],
        )
        self.location.ask(command, self.rig.clock.now())

    @property
    def reply(self) -> link.Reply:
        [reply] = self.rig.book.replies
        return reply

    @property
    def findings(self) -> list[Finding]:
        assert self.reply.error == "Refused"
        return list(self.reply.parameters["findings"])


@pytest.fixture
def scene() -> Scene:
    return Scene()


def test_stated_angles_become_counts_of_each_actuator_and_the_reply_is_where_the_joints_stand(
    scene: Scene,
) -> None:
    scene.ask(1, 2)
    near = TURN // 8
    assert scene.turns.places == {1: StatedPlace(350, near, "ann"), 2: StatedPlace(100, near, "ann")}
    scene.rig.tick()
    assert scene.rig.book.replies == [] and scene.turns.withdrawn == []
    scene.turns.turn_known[1:] = True
    measured = scene.rig.robot.measured
    scene.rig.robot.measured = replace(measured, position=np.array([0.3, 0.51, nan]))
    scene.rig.tick()
    assert scene.reply.error is None and scene.reply.parameters == {"positions": [0.51, None]}
    [event] = scene.rig.book.events
    assert (event.level, event.code) == ("info", "HOMING")
    assert event.message == "ann: the turn of knee, toe is that of a stated pose"
    assert scene.turns.withdrawn == [[1, 2]]


def test_a_joint_whose_turn_is_known_is_answered_at_the_next_tick(scene: Scene) -> None:
    scene.turns.turn_known[1] = True
    scene.ask(1)
    scene.rig.tick()
    assert scene.reply.error is None


@pytest.mark.parametrize("joint", [1, 2])
def test_one_contradiction_refuses_all_places_at_once(scene: Scene, joint: int) -> None:
    scene.turns.against = {joint: ASIDE}
    scene.ask(1, 2)
    assert scene.findings == [ASIDE] and scene.turns.withdrawn == [[1, 2]]


def test_a_turn_that_the_readings_refuse_is_the_reason_once_no_place_waits(scene: Scene) -> None:
    scene.turns.refused = [ASIDE]
    scene.ask(1)
    scene.rig.ticks(5)
    assert scene.rig.book.replies == []
    scene.turns.waits = False
    scene.rig.tick()
    assert scene.findings == [ASIDE] and scene.turns.withdrawn == [[1]]


def test_without_a_refused_turn_a_joint_is_waited_for_although_its_place_is_gone(scene: Scene) -> None:
    scene.turns.waits = False
    scene.ask(1)
    scene.rig.ticks(5)
    assert scene.rig.book.replies == []


def test_joints_without_a_turn_after_two_seconds_are_named(scene: Scene) -> None:
    scene.turns.turn_known[1] = True
    scene.ask(1, 2)
    scene.rig.ticks(round(1.98 / PERIOD))
    assert scene.rig.book.replies == []
    scene.rig.ticks(4)
    [finding] = scene.findings
    assert (finding.code, finding.joint) == (ReasonCode.CALIB_MISMATCH, 2)
    assert "its turn is still unknown" in finding.message
    assert scene.turns.withdrawn == [[1, 2]] and scene.rig.book.events == []


# ------------------------------------------------------------------------------- not begun


def test_without_the_lease_no_turn_is_chosen(scene: Scene) -> None:
    scene.ask(1, client=OTHER)
    assert [each.code for each in scene.findings] == [ReasonCode.LEASE_MISSING]
    assert scene.findings[0].message == "this connection does not hold the lease"
    assert scene.turns.places == {}


def test_a_stated_pose_renews_the_lease(scene: Scene) -> None:
    scene.rig.ticks(round(0.9 / PERIOD))
    scene.ask(1)
    scene.rig.ticks(round(0.9 / PERIOD))
    assert scene.lease.held_by(CLIENT, scene.rig.clock.now())


@pytest.mark.parametrize("torque", [-1, 1])
def test_with_torque_on_or_unread_no_turn_is_chosen(scene: Scene, torque: int) -> None:
    scene.rig.hardware.slow.torque[0] = torque
    scene.ask(1)
    assert scene.reply.error == "WrongState" and scene.turns.places == {}
    assert scene.reply.parameters == {
        "state": "calibrating, torque on or not read",
        "allowed": ["calibrating, torque off"],
    }


def test_outside_of_calibrating_no_turn_is_chosen(scene: Scene) -> None:
    scene.rig.condition.change(RobotEvent.CALIBRATED)
    scene.ask(1)
    assert scene.reply.error == "WrongState" and scene.turns.places == {}
    assert scene.reply.parameters["state"] == "connected"


def test_joints_without_a_zero_are_named(scene: Scene) -> None:
    joints: Any = scene.rig.robot.joints
    joints.calibrated = (True, False, True)
    scene.ask(1, 2)
    [finding] = scene.findings
    assert (finding.code, finding.joint) == (ReasonCode.CALIB_MISSING, 1)
    assert finding.message == "no measured zero; calibrate this joint"
    assert scene.turns.places == {}
