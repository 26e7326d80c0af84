"""A joint beyond its hard limit is taken over within the guard's tolerance only. Real bytes."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.config.robot_file import load_robot
from twind.loop.procedures.lowering import SettleProfile
from twind.robot.finding import Finding, ReasonCode
from twind.safety.guard import GuardThresholds
from twind_drivers.bus import BusError

BEYOND = 2.4  # rad, of a knee that may go to 2.25


@contextmanager
def found_on(robot: str = "h24", **more: float) -> Iterator[Rig]:
    """A robot with torque on that nobody of ours has switched on."""
    rig = Rig(robot, start={**load_robot(robot).poses["rest"], **more}, rate_hz=50.0)
    for bus in rig.virtual.values():
        for row in range(len(bus.servos["torque_enable"])):
            bus.servos.torque(row, True)
    rig.connect()
    try:
        yield rig
    finally:
        rig.close()


def moved(rig: Rig, seconds: float) -> np.ndarray:
    """Return the largest distance of each joint from its start, rad (n,)."""
    began = rig.truth
    most = np.zeros(len(rig.names))
    for _ in range(round(seconds / rig.loop.robot.period)):
        rig.ticks(1)
        most = np.maximum(most, np.abs(rig.truth - began))
    return most


def joint_codes(rig: Rig) -> list[str]:
    return [
        event.message for event in rig.events(ReasonCode.OUT_OF_LIMIT) if "would be a step" in event.message
    ]


@pytest.mark.parametrize("command", ["disarm", "e-stop"])
def test_torque_goes_off_without_motion_where_a_joint_is_beyond_its_hard_limit(command: str) -> None:
    with found_on(l_knee=BEYOND) as rig:
        ticket = rig.send(link.Disarm) if command == "disarm" else rig.send(link.EStop, level="settle")
        assert moved(rig, 4.0).max() < 0.01
        assert not rig.register("torque_enable").any()
        assert rig.replies(ticket)[-1].error is None
        assert any("l_knee" in message and "torque goes off" in message for message in joint_codes(rig))


def test_a_robot_one_count_beyond_a_limit_is_lowered() -> None:
    with found_on(l_knee=2.2505) as rig:
        assert rig.call(link.Disarm).error is None
        assert np.abs(rig.truth - rig.loop.robot.rest).max() < 0.05
        assert not joint_codes(rig)


def test_a_full_takeover_fails_and_leaves_torque_on_where_a_joint_is_beyond_its_limit() -> None:
    with found_on(l_knee=BEYOND) as rig:
        why = Finding(ReasonCode.NOT_ARMED, message="the daemon was given up")
        way = rig.loop.commands.release.release(why, SettleProfile(whole=True))
        with pytest.raises(BusError, match="l_knee"):
            next(way)
        assert moved(rig, 1.0).max() < 0.01
        assert rig.register("torque_enable").all()


def test_sigterm_releases_an_armed_robot_moved_beyond_its_limit_while_unplugged(make_rig: MakeRig) -> None:
    rig = make_rig(rate_hz=50.0)
    rig.arm()
    rig.virtual["main"].faults.unplug()
    rig.seconds(1.0)
    push(rig, "l_knee", BEYOND)
    rig.virtual["main"].faults.replug()
    while not rig.loop.hardware.connected:
        rig.ticks(1)
    rig.ticks(5)
    assert rig.truth[rig.names.index("l_knee")] == pytest.approx(BEYOND, abs=0.01)
    rig.loop.condition.stop_wanted = True
    assert moved(rig, 4.0).max() < 0.01
    assert rig.loop.condition.finished
    assert not rig.register("torque_enable").any()
    assert joint_codes(rig)


def test_a_bus_that_is_back_with_a_joint_beyond_is_not_taken_over_and_the_others_come_down(
    make_rig: MakeRig,
) -> None:
    rig = make_rig(
        "h24-split", start={"head_yaw": 0.4, **load_robot("h24-split").poses["rest"]}, rate_hz=50.0
    )
    rig.arm()
    name = next(joint.bus for joint in rig.robot.joints if joint.name == "l_knee")
    away = np.array([joint.bus == name for joint in rig.robot.joints])
    rig.virtual[name].faults.unplug()
    rig.seconds(0.5)
    push(rig, "l_knee", BEYOND)
    rig.virtual[name].faults.replug()
    rig.seconds(1.5)
    assert rig.loop.hardware.energised_joints.tolist() == (~away).tolist()
    rig.send(link.Disarm)
    assert moved(rig, 6.0)[away].max() < 0.01
    assert not rig.register("torque_enable").any()
    assert any("not taken over" in message and "l_knee" in message for message in joint_codes(rig))


def push(rig: Rig, joint: str, to: float) -> None:
    """While nobody looks a joint is turned by force, and its servo holds it there; rad."""
    found = next(each for each in rig.robot.joints if each.name == joint)
    bus = rig.virtual[found.bus]
    row = [each.name for each in rig.robot.joints if each.bus == found.bus].index(joint)
    counts = rig.zeros[joint] + to * found.sign * found.ratio * found.type.ticks_per_turn / (2 * np.pi)
    rig.advance_servos()
    bus.servos.muscles.position[row] = bus.servos.muscles.goal[row] = counts


# ------------------------------------------------------------ a joint that rests on its mechanical stop

STOPS = {"l_knee": -0.15, "r_elbow": 0.15}  # rad, hard limits that are the model's range, where a stop is
COUNT = 2.0 * np.pi / 4096  # rad
STOP_READING = 0.0007  # rad past the limit that was measured at a stop


def resting(past: float) -> dict[str, float]:
    return {name: limit + np.sign(limit) * past for name, limit in STOPS.items()}


@pytest.mark.parametrize("past", [STOP_READING, 0.0085])
@pytest.mark.parametrize("by", ["motion", "setpoints"])
def test_a_joint_on_its_stop_is_armed_does_not_push_outward_and_moves_inside(
    make_rig: MakeRig, past: float, by: str
) -> None:
    start = load_robot("h24").poses["rest"] | resting(past)
    rig = make_rig(start=start)
    places = [rig.names.index(name) for name in STOPS]
    outward = np.sign(list(STOPS.values()))
    begun = rig.truth[places]
    rig.arm()
    rig.seconds(0.5)
    held = rig.truth[places]
    assert (outward * (held - begun)).max() < 1e-6
    # The goal is the end of the range, rounded inwards to a whole count.
    assert np.abs(held - begun).max() <= GuardThresholds().beyond_hard + COUNT
    goals = {name: float(limit - 0.4 * np.sign(limit)) for name, limit in STOPS.items()}
    if by == "motion":
        path = rig.path("l_knee", [goals["l_knee"]], [2.0])
        path.commanded[places[1]] = True
        path.position[:, places[1]] = goals["r_elbow"]
        answer = rig.submit(path, more=True)
    steps = []
    for _ in range(250):
        before = rig.truth[places]
        if by == "setpoints":
            answer = rig.send(link.Setpoint, joints=places, positions=list(goals.values()))
        rig.ticks(1)
        steps.append(rig.truth[places] - before)
        assert rig.replies(answer)[-1].error is None if by == "setpoints" else True
    assert (outward * np.array(steps)).max() < 1e-6
    assert np.abs(steps).max() < 4.0 * rig.loop.robot.period, "a jump"
    assert rig.truth[places] == pytest.approx(list(goals.values()), abs=0.01)
    if by == "motion":
        assert [reply.error for reply in rig.replies(answer)] == [None] * len(rig.replies(answer))
    assert not rig.events(ReasonCode.OUT_OF_LIMIT) and not rig.loop.condition.latches


@pytest.mark.parametrize("joint", STOPS)
def test_a_joint_a_hundredth_of_a_radian_past_its_limit_is_not_armed(make_rig: MakeRig, joint: str) -> None:
    rig = make_rig(start=load_robot("h24").poses["rest"] | {joint: resting(0.01)[joint]})
    rig.connect()
    rig.lease()
    reply = rig.call(link.Arm)
    assert reply.error == "Refused"
    [finding] = reply.parameters["findings"]
    assert (finding["code"], finding["joint"]) == ("OUT_OF_LIMIT", rig.names.index(joint))
    assert abs(finding["value"]) == pytest.approx(0.16, abs=1e-3)
    assert abs(finding["bound"]) == pytest.approx(0.15 + GuardThresholds().beyond_hard)
    assert "move it inside by hand" in finding["message"]
    assert not rig.register("torque_enable").any()


def test_a_joint_that_a_hand_takes_off_its_path_and_beyond_its_limit_stops_no_other_goal() -> None:
    """Its hard limit lies between two counts, and rounds to the one that may not be sent."""
    joint = "l_shoulder_pitch"
    rig = Rig("h24", start={joint: 2.6})
    rig.arm()
    place = rig.names.index(joint)
    bus = rig.one.binding.joint_map.buses[0]
    row = int(np.flatnonzero(bus.joints == place)[0])
    limit = bus.zero[row] + rig.one.binding.limits.hard_upper[place] / bus.scale[row]
    assert round(limit) > bus.upper[row]
    rig.submit(rig.path(joint, [2.6, 2.4], [0.5, 3.0]), tolerances=[(place, 0.15, None)])
    rig.ticks(40)
    for _ in range(100):
        rig.virtual["main"].servos.muscles.position[row] = limit + 60.0
        rig.ticks(1)
    assert not rig.events("WIRE_CLAMP")
    [ended] = [event for event in rig.events("MOTION") if event.phase == "aborted"]
    assert ended.findings[0].code is ReasonCode.PATH_TOLERANCE
    assert rig.loop.robot.written[place] == pytest.approx(2.75, abs=0.002)
    rig.close()
