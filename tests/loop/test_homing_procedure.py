"""A joint driven against its stop by the whole loop: where it was found, and that everything is undone after.

What is undone is read in the servos themselves, past the bus and the daemon's word.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.described_robot import redescribe
from tests.support.homing_rig import JOINT, OTHER, RAD, Homed, codes, energise, failed, homed
from twind import link
from twind.config.counts import ticks_of
from twind.config.homing_config import JointEndstops
from twind.config.robot_file import load_robot
from twind.loop.procedures.torque_readback import torque_off
from twind.motion import endstop_search
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode
from twind.virtual.virtual_robot_spec import buses

# ------------------------------------------------------------------------------- found


@pytest.mark.parametrize("side", ["lower", "upper"])
@pytest.mark.parametrize("joint", [JOINT, "r_shoulder_pitch"])  # signs +1 and -1
def test_the_stop_is_found_within_3_counts_and_all_is_undone(joint: str, side: str) -> None:
    at = {(JOINT, "lower"): -1.3, (JOINT, "upper"): 1.3}.get((joint, side), {"lower": -2.4}.get(side, 2.4))
    with homed(joint=joint, start={joint: at}) as made:
        made.ready()
        ticket = made.find(side, more=True, speed=0.5)
        reply = made.last(ticket)
        assert reply.error is None and codes(reply) == [], reply
        assert reply.parameters["phase"] == "found" and reply.parameters["progress"] == 1.0
        assert len(reply.parameters["ticks"]) == 3
        assert all(abs(count - made.stop(side)) <= 3 for count in reply.parameters["ticks"])
        made.undone()
        assert made.loop.condition.state == "calibrating"
        told = [each.parameters for each in made.replies(ticket)]
        assert [each["progress"] for each in told] == sorted(each["progress"] for each in told)
        phases = list(dict.fromkeys(each["phase"] for each in told))
        assert phases == ["waiting", "approaching", "backing off", "found"]


@pytest.mark.parametrize("off", [-0.15, 0.15])
@pytest.mark.parametrize("start", ["in its travel", "against its stop"])
def test_a_coarse_zero_may_be_off_by_what_the_margin_allows(off: float, start: str) -> None:
    end = -1.6 + off
    begin = {"in its travel": {JOINT: -0.8}, "against its stop": {JOINT: end + 0.002}}[start]
    with homed(truth={"stops_rad": (end, 1.6)}, start=begin) as made:
        made.ready()
        reply = made.last(made.find(times=2, speed=0.5))
        where = ticks_of(made.spec, made.made.shown[JOINT], end)
        assert codes(reply) == [] and all(abs(count - where) <= 3 for count in reply.parameters["ticks"])
        made.undone()


@pytest.mark.parametrize("turns", [-1, 3])
def test_a_servo_of_position_mode_that_is_turns_off_is_not_driven(turns: int) -> None:
    with homed(truth={"turns": turns}) as made:
        made.ready(odd=True)
        reply = made.last(made.find(times=2, speed=0.5))
        assert codes(reply) == ["CALIB_MISMATCH"], reply
        made.undone()


@pytest.mark.parametrize("end", [-1.6, -1.9])
def test_afterwards_the_robot_is_identified_and_arms_where_it_is(end: float) -> None:
    with homed(truth={"stops_rad": (end, 1.6)}) as made:
        described(made, stops=replace(made.spec.stops, lower=end))
        made.ready(odd=False)
        assert codes(made.last(made.find(times=2, speed=0.5))) == []
        made.undone()
        assert made.call(link.Calibrate, on=False).error is None
        made.connect()
        made.call(link.AcquireLease)
        reply = made.call(link.Arm)
        assert reply.error is None, reply


# ------------------------------------------------------------------------------- while it lasts


def test_only_its_servo_has_torque_and_it_is_weak_slow_and_watched() -> None:
    with homed() as made:
        made.ready()
        made.powered(made.find())
        assert [made.row] == np.flatnonzero(made.torques()).tolist()
        assert made.get("operating_mode") == 5
        full = made.spec.type.full_effort
        assert made.get("goal_current") == int(endstop_search.USUAL_SHARE * full)
        assert made.get("bus_watchdog") == 5
        assert made.get("profile_velocity") * 0.02398 == pytest.approx(
            2.0 * endstop_search.USUAL_SPEED, abs=0.03
        )
        before = made.bus.servos["goal_position"].tolist()
        made.seconds(1.0)
        after = made.bus.servos["goal_position"].tolist()
        moved = [place for place, (a, b) in enumerate(zip(before, after, strict=True)) if a != b]
        assert moved == [made.row], "goals went to somebody else"
        assert abs(after[made.row] - before[made.row]) == pytest.approx(
            endstop_search.USUAL_SPEED * RAD, abs=3
        )
        assert made.loop.condition.state == "calibrating" and not made.loop.torque.armed
        assert torque_off(made.loop) is False


def test_during_homing_neither_arming_nor_a_second_search_begins() -> None:
    with homed() as made:
        made.ready()
        first = made.find(more=True)
        made.powered(first)
        for kind, how in (
            (link.Arm, {}),
            (link.FindStop, {"joint": 3, "side": "lower"}),
            (link.Calibrate, {"on": False}),
            (link.WriteRegister, {"bus": "main", "id": 2, "name": "led", "value": 1}),
        ):
            assert made.call(kind, **how).error in ("Busy", "WrongState"), kind
        assert made.last(first).parameters["phase"] == "found"
        made.undone()


def test_goals_keep_inside_the_window_on_the_wire() -> None:
    with homed(truth={"stops_rad": (-2.6, 1.6)}) as made:
        made.ready()
        ticket = made.find(speed=0.5)
        goals = []
        while not [reply for reply in made.replies(ticket) if not reply.continues]:
            made.ticks(1)
            if made.get("torque_enable"):
                goals.append(made.get("goal_position"))
        end = made.stop() - round(endstop_search.MARGIN * RAD)
        assert end - 2 <= min(goals) <= end + 2, "it did not look to the end of its window, or went beyond"
        made.undone()


# ------------------------------------------------------------------------------- not begun


@pytest.mark.parametrize(
    ("how", "code"),
    [
        ({"current_share": 0.2}, ReasonCode.BAD_SCHEMA),
        ({"current_share": float("nan")}, ReasonCode.BAD_SCHEMA),
        ({"speed": 0.6}, ReasonCode.BAD_SCHEMA),
        ({"speed": -0.1}, ReasonCode.BAD_SCHEMA),
        ({"times": 1}, ReasonCode.BAD_SCHEMA),
        ({"client": OTHER}, ReasonCode.LEASE_MISSING),
    ],
)
def test_an_excessive_homing_request_is_refused_and_nothing_is_written(
    how: dict[str, Any], code: ReasonCode
) -> None:
    with homed() as made:
        made.ready()
        reply = made.last(made.find(**how))
        assert reply.error == "Refused" and codes(reply) == [code]
        made.undone()


def test_homing_requires_the_state_calibrating_and_mode_live() -> None:
    with homed() as made:
        made.connect()
        made.lease()
        reply = made.last(made.find())
        assert reply.error == "WrongState" and reply.parameters["allowed"] == ["calibrating"]
    with homed(mode=Mode.MIRROR) as made:
        made.connect()
        made.lease()
        assert made.call(link.Calibrate, on=True).error is None
        reply = made.last(made.find())
        assert reply.error == "Refused" and ReasonCode.MODE_DENIES in codes(reply)


def test_a_leg_of_a_robot_that_stands_freely_is_refused() -> None:
    with homed(joint="l_knee", support="free") as made:
        made.ready()
        reply = made.last(made.find())
        assert reply.error == "Refused" and "support: gantry" in reply.parameters["findings"][0]["message"]
        made.undone()


@pytest.mark.parametrize("robot", ["h24-mixed"])
def test_a_can_actuator_is_refused_by_its_name(robot: str) -> None:
    name = next(joint.name for joint in load_robot(robot).joints if joint.type.BUS == "can")
    with homed(joint=name, robot=robot, start={}) as made:
        made.connect()
        made.lease()
        assert made.call(link.Calibrate, on=True).error is None
        reply = made.last(made.find())
        assert reply.error == "Refused"
        assert any("is not driven against a stop" in each["message"] for each in reply.parameters["findings"])


def test_a_joint_that_swings_is_not_driven() -> None:
    with homed() as made:
        made.ready()
        ticket = made.find()
        for tick in range(400):
            made.bus.servos.muscles.position[made.row] += 20.0 * (-1) ** (tick // 4)
            made.ticks(1)
        assert failed(made, ticket) == [ReasonCode.STOP_NOT_FOUND]
        assert not made.events("HOMING")[1:], "it went on"


def test_a_servo_that_refuses_the_homing_mode_is_left_unchanged() -> None:
    with homed(truth={"registers": {"drive_mode": 0}}) as made:
        made.ready()
        energise(made, made.row)  # its torque came on unseen, just now
        reply = made.last(made.find())
        assert reply.error == "Refused" or codes(reply)
        made.put("torque_enable", 0)
        made.undone()


def described(made: Homed, **changes: Any) -> None:
    """The robot file says something else of its joint."""
    made.spec = replace(made.spec, **changes)
    joints = tuple(made.spec if each.name == JOINT else each for each in made.robot.joints)
    redescribe(made.loop, bound=replace(made.one, file=replace(made.robot, joints=joints)))


NOT_BEGUN: Mapping[str, tuple[Callable[[Homed], Any], str]] = {
    "somebody has torque": (lambda made: (energise(made, 5), made.ticks(30)), "torque is on somewhere"),
    "a bus is asked anew": (lambda made: made.loop.hardware.ports[0].identify(), "open and identified"),
    "a restart": (
        lambda made: made.loop.identity.verified.mar([Finding(ReasonCode.INTERNAL, made.place)]),
        "restarted",
    ),
    "turned with others": (lambda made: described(made, transmission="waist"), "transmission waist"),
    "no stop there": (lambda made: described(made, stops=JointEndstops(upper=1.6)), "no stop_rad.lower"),
    "beyond it": (
        lambda made: described(made, stops=JointEndstops(lower=-1.0)),
        "beyond where the stop should be",
    ),
    "too slow": (lambda made: redescribe(made.loop, period=0.05), "the loop runs at 20 Hz"),
}


@pytest.mark.parametrize("name", NOT_BEGUN)
def test_each_obstacle_to_homing_is_reported_and_nothing_is_written(name: str) -> None:
    wrong, said = NOT_BEGUN[name]
    with homed() as made:
        made.ready()
        wrong(made)
        ticket = made.find()
        made.ticks(1)
        reply = made.replies(ticket)[-1]
        assert reply.error == "Refused"
        assert any(said in each["message"] for each in reply.parameters["findings"]), reply.parameters
        assert made.settings() == made.before and not made.get("torque_enable")


class Bodily(Homed):
    """The same with a body: inertia, gravity, friction, play."""

    def _virtual(self, bus: str, start: Mapping[str, float]) -> Any:
        return buses(self.made, now=self.clock.now())[bus]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joint", "side"), [("head_yaw", "upper"), ("l_knee", "lower"), ("l_elbow", "lower")]
)
def test_a_stop_of_a_body_with_friction_and_play_is_found_within_3_counts(joint: str, side: str) -> None:
    made = Bodily(joint, truth={"friction_nm": 0.08, "backlash_ticks": 4.0})
    try:
        made.ready()
        reply = made.last(made.find(side, speed=0.3))
        assert codes(reply) == [], reply
        assert all(abs(count - made.stop(side)) <= 3 for count in reply.parameters["ticks"])
        made.undone()
    finally:
        made.close()
