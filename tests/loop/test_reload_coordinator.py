"""Changes put in force between two ticks: by everybody who keeps limits, at rest only, whole or not."""

import os
import socket
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from tests.support.daemon_rig import CLIENT, MakeRig, Rig
from tests.support.reload_changes import NARROW, YAW, codes, held
from tests.support.scene_rig import move
from twind import link
from twind.loop.bus.joint_readings import ticks
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode
from twind.robot.trajectory import Trajectory
from twind.safety.guard_types import GuardThresholds
from twind_drivers.bus import WireRangeError


@pytest.fixture
def quiet(make_rig: MakeRig) -> Rig:
    """Live, connected, torque off."""
    rig: Rig = make_rig()
    rig.connect()
    return rig


# ------------------------------------------------------------------------------- everybody has it


def kept(thing: object, depth: int = 0) -> Iterator[np.ndarray]:
    """Every array that an object keeps, of its own or inside what it keeps."""
    if isinstance(thing, np.ndarray):
        yield thing
    elif depth < 3 and type(thing).__module__.startswith(("twind", "rig")):
        names = getattr(type(thing), "__slots__", ()) or getattr(thing, "__dict__", ())
        for name in names:
            yield from kept(getattr(thing, name, None), depth + 1)


def test_reduced_limits_reach_every_object_that_keeps_limits(quiet: Rig) -> None:
    loop = quiet.loop
    guard = loop.parts.guard
    old = loop.robot.limits
    old_reach = [ends.copy() for ends in loop.hardware.reach]
    reply = quiet.adopt(NARROW)
    assert (reply.error, reply.parameters["applied"]) == (None, sorted(NARROW))
    joint = quiet.names.index("head_yaw")
    new = loop.robot.limits
    assert (new.lower[joint], new.upper[joint], new.velocity[joint]) == (-0.3, 0.3, 0.5)
    assert (new.hard_lower[joint], new.hard_upper[joint]) == pytest.approx((-0.35, 0.35), abs=0.01)
    others = np.arange(len(quiet.names)) != joint
    for field in fields(old):
        assert np.array_equal(getattr(old, field.name)[others], getattr(new, field.name)[others]), field.name
    for holder in (loop.robot, loop.executor):
        assert holder.limits is new, type(holder).__name__
    low, high = loop.hardware.reach
    assert low[joint] > old_reach[0][joint] and high[joint] < old_reach[1][joint]
    assert (low[joint], high[joint]) == pytest.approx((-0.35, 0.35), abs=0.01)
    _, bus = loop.hardware.pairs[0]
    row = bus.joints.tolist().index(joint)
    assert bus.lower[row] > rig_map(quiet).buses[0].lower[row]
    assert loop.robot.joints is loop.hardware.joints is loop.robot.bound.binding.joint_map
    assert loop.robot.limits is loop.robot.bound.binding.limits
    assert loop.parts.guard is guard  # it keeps the memory of its rules
    bounds = GuardThresholds()
    fastest = bounds.overspeed * old.velocity + bounds.overspeed_slack
    highest = old.hard_upper + bounds.beyond_hard
    stale = [old.lower, old.upper, old.hard_lower, old.hard_upper, old.velocity, fastest, highest]
    for holder in (
        loop.executor,
        loop.robot.outlook,
        loop.parts.guard,
        loop.commands.submissions,
        loop.parts.health,
        loop.hardware,
        loop.commands.stops,
    ):
        left = [array for array in kept(holder) if any(np.array_equal(array, one) for one in stale)]
        assert not left, f"{type(holder).__name__} keeps limits that are no longer in force"


def rig_map(rig: Rig) -> Any:
    """As the robot was bound at the start."""
    return rig.one.binding.joint_map


def test_gate_stream_guard_and_executor_judge_by_the_new_limits(quiet: Rig) -> None:
    assert quiet.adopt(NARROW).error is None
    quiet.call(link.AcquireLease)
    assert quiet.call(link.Arm).error is None
    for path, code in ((([0.35], [3.0]), ReasonCode.POS_LIMIT), (([0.25], [0.3]), ReasonCode.VEL_LIMIT)):
        quiet.lease()
        ticket = quiet.submit(quiet.path("head_yaw", *path))
        quiet.ticks(5)
        assert code in codes(quiet.replies(ticket)[-1])
    quiet.lease()
    place = quiet.names.index("head_yaw")
    streamed = quiet.call(link.Setpoint, joints=[place], positions=[0.31])
    assert codes(streamed) == [ReasonCode.POS_LIMIT]
    ticket = quiet.submit(quiet.path("head_yaw", [0.29], [1.0]), more=True)
    for _ in range(15):
        quiet.lease()
        quiet.ticks(10)
    assert quiet.replies(ticket)[-1].parameters["phase"] == "succeeded", quiet.replies(ticket)
    step = np.zeros(len(quiet.names))
    step[place] = 0.3
    quiet.loop.hardware.ports[0].writer.goals(quiet_ticks(quiet, step))
    step[place] = 0.4
    with pytest.raises(WireRangeError):
        quiet.loop.hardware.ports[0].writer.goals(quiet_ticks(quiet, step))


def quiet_ticks(rig: Rig, position: Any) -> Any:
    return ticks(rig.loop.hardware.pairs[0][1], position)


def test_gains_are_those_that_the_next_arming_writes(quiet: Rig) -> None:
    kind = quiet.robot.joints[0].type.name
    assert quiet.adopt({f"types.{kind}.gains": {"p": 321, "i": 0, "d": 7}}).error is None
    assert 321 not in quiet.register("position_p_gain"), "not before torque is asked for"
    quiet.call(link.AcquireLease)
    assert quiet.call(link.Arm).error is None
    assert set(quiet.register("position_p_gain").tolist()) == {321}
    assert set(quiet.register("position_d_gain").tolist()) == {7}


def test_thresholds_change_at_any_time_and_the_log_level_is_nothing_to_the_loop(armed: Rig) -> None:
    reply = armed.adopt({"thresholds.latency_warn_ms": 20.0, "log_level": "debug"}, reread=False)
    assert reply.error is None
    assert armed.loop.commands.gate_input.thresholds.latency_warn == 0.02
    health = armed.loop.parts.health
    assert {health.total.threshold, health.hops["reply"].threshold} == {0.02}
    assert armed.loop.torque.armed


def test_a_simulated_robot_is_changed_too_and_holds_where_it_was(make_rig: MakeRig) -> None:
    rig = make_rig(mode=Mode.SIM)
    rig.ticks(5)
    place = rig.loop.executor.reference.position.copy()
    assert rig.adopt(NARROW).error is None
    rig.ticks(50)
    assert np.array_equal(rig.loop.executor.reference.position, place)
    rig.lease()
    ticket = rig.submit(rig.path("head_yaw", [0.35], [3.0]))
    rig.ticks(5)
    assert ReasonCode.POS_LIMIT in codes(rig.replies(ticket)[-1])


# ------------------------------------------------------------------------------- or nobody


@pytest.mark.parametrize(
    "changes",
    [
        {f"{YAW}.limits_rad": [-9.0, 9.0]},
        {**NARROW, f"{YAW}.acceleration_limit_rad_s2": float("nan")},
        {**NARROW, "thresholds.latency_warn_ms": 60.0},
        {**NARROW, "support": "fixed"},
        {**NARROW, "log_level": "loud"},
    ],
)
def test_a_change_that_may_not_be_made_changes_nothing(quiet: Rig, changes: dict[str, Any]) -> None:
    before = held(quiet)
    reply = quiet.adopt(changes)
    assert (reply.error, codes(reply)) == ("Refused", [ReasonCode.CONFIG_REFUSED])
    assert all(one is other for one, other in zip(before, held(quiet), strict=True))
    assert quiet.front.briefings == []
    assert quiet.loop.commands.reloads.generation == 0


def test_limits_do_not_change_while_torque_is_on(armed: Rig) -> None:
    before = held(armed)
    reply = armed.adopt(NARROW)
    assert codes(reply) == [ReasonCode.BUSY]
    assert "disarm" in reply.parameters["findings"][0]["message"]
    assert all(one is other for one, other in zip(before, held(armed), strict=True))
    assert (armed.register("torque_enable") == 1).all()


def test_limits_do_not_change_while_torque_was_found_on(make_rig: MakeRig) -> None:
    rig = make_rig()
    for row in range(len(rig.names)):
        rig.virtual["main"].servos.torque(row, True)
    rig.connect()
    assert codes(rig.adopt(NARROW)) == [ReasonCode.BUSY]


def test_limits_do_not_change_while_a_bus_is_away_that_may_have_torque(make_rig: MakeRig) -> None:
    rig = make_rig()
    for row in range(len(rig.names)):
        rig.virtual["main"].servos.torque(row, True)
    rig.connect()
    rig.virtual["main"].faults.unplug()
    rig.seconds(1.0)
    before = held(rig)
    reply = rig.adopt(NARROW)
    assert codes(reply) == [ReasonCode.BUSY]
    assert "not known of bus main" in reply.parameters["findings"][0]["message"]
    assert all(one is other for one, other in zip(before, held(rig), strict=True))
    assert rig.adopt({"thresholds.latency_warn_ms": 20.0}).error is None, "nothing of the robot"
    rig.virtual["main"].faults.replug()
    rig.connect()
    rig.call(link.Disarm)
    assert rig.adopt(NARROW).error is None


def test_limits_do_not_change_while_a_simulated_robot_moves_or_brakes(make_rig: MakeRig) -> None:
    rig = make_rig(mode=Mode.SIM)
    rig.ticks(5)
    slower = {"joints.l_elbow.velocity_limit_rad_s": 0.5}
    move(rig, to=1.0, seconds=1.5)
    rig.ticks(50)
    assert codes(rig.adopt(slower)) == [ReasonCode.BUSY]
    rig.send(link.Cancel)
    rig.ticks(1)
    assert codes(rig.adopt(slower)) == [ReasonCode.BUSY], "it brakes still"
    rig.seconds(1.0)
    assert rig.adopt(slower).error is None


def test_limits_do_not_change_while_a_long_path_is_judged(make_rig: MakeRig) -> None:
    rig = make_rig(mode=Mode.SIM)
    rig.ticks(5)
    rig.lease()
    count = 1500
    time = np.arange(1, count + 1) * 0.03
    rows = np.tile(rig.loop.robot.simulated.position, (count, 1))
    rig.submit(Trajectory(time, rows, np.ones(len(rig.names), np.bool_)))
    reply = rig.adopt(NARROW)
    assert codes(reply) == [ReasonCode.BUSY]
    assert "judged" in reply.parameters["findings"][0]["message"]


def test_limits_do_not_change_during_a_device_procedure(quiet: Rig) -> None:
    before = held(quiet)
    ticket = quiet.send(link.Reboot, bus="main", id=5)
    quiet.ticks(3)
    reply = quiet.adopt(NARROW)
    assert codes(reply) == [ReasonCode.BUSY]
    assert "on bus main" in reply.parameters["findings"][0]["message"]
    assert all(one is other for one, other in zip(before, held(quiet), strict=True))
    quiet.seconds(3.0)
    assert quiet.replies(ticket)[-1].error is None, "it ended as if nobody had reloaded"
    assert quiet.adopt(NARROW).error is None


def test_a_joint_outside_the_new_limits_is_reported_and_the_change_refused(make_rig: MakeRig) -> None:
    rig = make_rig(start={"head_yaw": 0.5})
    rig.connect()
    reply = rig.adopt(NARROW)
    assert codes(reply) == [ReasonCode.POS_LIMIT]
    found = reply.parameters["findings"][0]
    assert rig.names[found["joint"]] == "head_yaw"
    assert (found["value"], found["bound"]) == (pytest.approx(0.5, abs=0.01), 0.3)
    other = {"joints.l_elbow.velocity_limit_rad_s": 0.5}
    assert rig.adopt(other).error is None, "whose place it is no fault of"


def test_changes_that_others_overtook_are_refused(quiet: Rig) -> None:
    assert quiet.adopt(NARROW, generation=2).error == "Refused"
    assert quiet.adopt(NARROW, generation=0).error == "Refused"
    assert quiet.adopt(NARROW).error is None
    assert quiet.loop.commands.reloads.generation == 1
    assert len(quiet.front.briefings) == 1, "the next front is told"


def test_a_changeable_briefing_is_as_good_as_a_broken_front(quiet: Rig) -> None:
    before = held(quiet)
    command = link.ApplyChanges(ticket=99, client=0, changes=NARROW, generation=1)
    fd = os.memfd_create("loose")
    os.write(fd, b"x")
    socket.send_fds(quiet.front.outer, [link.encode(command)], [fd])
    os.close(fd)
    quiet.ticks(2)
    assert quiet.loop.parts.link.front.socket is None
    assert all(one is other for one, other in zip(before, held(quiet), strict=True))


def test_a_gain_that_a_can_actuator_s_frames_do_not_hold_changes_nothing(make_rig: MakeRig) -> None:
    rig = make_rig("h24-mixed")
    rig.connect()
    kind = next(joint.type for joint in rig.robot.joints if joint.type.BUS == "can")
    before = held(rig)
    reply = rig.adopt({f"types.{kind.name}.gains": {"kp": 1e6, "kd": 1.0}})
    assert (reply.error, codes(reply)) == ("Refused", [ReasonCode.CONFIG_REFUSED])
    assert all(one is other for one, other in zip(before, held(rig), strict=True))
    stiff = {"kp": kind.gains.kp / 2, "kd": kind.gains.kd}
    assert rig.adopt({f"types.{kind.name}.gains": stiff}).error is None
    writers = [port.writer for port in rig.loop.hardware.ports]
    assert not any(one is other for one, other in zip(writers, before[5::2], strict=True))


# ------------------------------------------------------------------------------- verdicts of before


def test_a_path_that_was_judged_by_the_old_limits_is_refused(quiet: Rig) -> None:
    assert quiet.adopt(NARROW).error is None
    quiet.call(link.AcquireLease)
    assert quiet.call(link.Arm).error is None
    late = quiet.submit(quiet.path("head_yaw", [0.2], [3.0]), generation=0)
    quiet.ticks(5)
    assert codes(quiet.replies(late)[-1]) == [ReasonCode.CMD_EXPIRED]
    quiet.lease()
    fresh = quiet.submit(quiet.path("head_yaw", [0.2], [3.0]), generation=1)
    quiet.ticks(5)
    assert quiet.replies(fresh)[-1].error is None


def test_settings_alone_do_not_make_a_verdict_old(quiet: Rig) -> None:
    quiet.adopt({"log_level": "debug"})
    quiet.call(link.AcquireLease)
    quiet.call(link.Arm)
    ticket = quiet.submit(quiet.path("head_yaw", [0.2], [3.0]), generation=0, client=CLIENT)
    quiet.ticks(5)
    assert quiet.replies(ticket)[-1].error is None


def test_gains_of_a_client_need_its_lease_and_those_of_the_front_need_none(quiet: Rig) -> None:
    tried = {"types.xm430.gains": {"p": 900, "i": 0, "d": 0}}
    reply = quiet.adopt(tried, reread=False, client=CLIENT)
    assert codes(reply) == [ReasonCode.LEASE_MISSING]
    quiet.lease()
    assert quiet.adopt(tried, reread=False, client=CLIENT).error is None
    assert quiet.adopt(tried, reread=False).error is None
    assert codes(quiet.adopt(tried, reread=False, client=CLIENT + 1)) == [ReasonCode.LEASE_MISSING]


def test_gains_that_a_client_tries_are_armed_and_changed_by_that_client_alone(quiet: Rig) -> None:
    tried = {"types.xm430.gains": {"p": 900, "i": 0, "d": 0}}
    of_file = {"types.xm430.gains": {"p": 1600, "i": 0, "d": 0}}
    quiet.lease()
    assert quiet.adopt(tried, reread=False, client=CLIENT, on_trial=True).error is None
    other = CLIENT + 1
    assert quiet.call(link.AcquireLease, client=other, take=True).error is None
    refused = quiet.call(link.Arm, client=other)
    assert codes(refused) == [ReasonCode.BUSY]
    assert codes(quiet.adopt(tried, reread=False, client=other, on_trial=True)) == [ReasonCode.BUSY]
    assert quiet.adopt(of_file, reread=False).error is None
    assert quiet.call(link.Arm, client=other).error is None


def test_the_client_that_tries_gains_arms_with_them(quiet: Rig) -> None:
    quiet.lease()
    tried = {"types.xm430.gains": {"p": 900, "i": 0, "d": 0}}
    assert quiet.adopt(tried, reread=False, client=CLIENT, on_trial=True).error is None
    assert quiet.adopt({"log_level": "debug"}, reread=False, client=CLIENT + 1, on_trial=True).error is None
    quiet.lease()
    assert quiet.call(link.Arm).error is None
