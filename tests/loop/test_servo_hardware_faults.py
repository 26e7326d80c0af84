"""Reactions of the whole loop to faults of servos, and their delay: threshold + refresh period + 2 ticks.

Refresh periods: position and current every tick, heat and supply every 20 ticks at 100 Hz; slow faults are
checked every 5.
"""

import json
from collections.abc import Callable

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.loop.procedures.torque_readback import torque_off
from twind.robot.modes import Motion, RobotState
from twind.robot.trajectory import Trajectory

# ticks
HEALTH = 20
LOOK = 5
SLACK = 2
VOTES = 3 * HEALTH + HEALTH  # three readings, and the register's own 0.1 s behind them


@pytest.fixture
def rig(make_rig: MakeRig) -> Rig:
    """Armed on a gantry, its lease kept, one joint going to and fro."""
    made: Rig = make_rig()
    made.arm()
    made.ticks(5 * HEALTH)
    return made


def nod(rig: Rig, joint: str = "head_yaw", seconds: float = 20.0) -> None:
    time = np.arange(1.0, seconds)
    rig.lease()
    rig.submit(
        rig.path(joint, np.where(np.arange(len(time)) % 2, -0.4, 0.4).tolist(), time.tolist()), more=True
    )
    rig.ticks(50)
    assert rig.loop.executor.motion is Motion.ACTIVE


def until(rig: Rig, what: Callable[[], bool], ticks: int) -> int:
    """Return the number of ticks until it holds; fail after `ticks`."""
    for count in range(1, ticks + 1):
        rig.ticks(1)
        if what():
            return count
    said = [(event.code, event.message) for event in rig.events()]
    raise AssertionError(f"not within {ticks} ticks: {rig.loop.condition.state}, {said}")


def is_reported(rig: Rig, code: str, joint: int | None = None) -> Callable[[], bool]:
    def is_found() -> bool:
        return any(joint in {one.joint for one in event.findings} for event in rig.events(code))

    return is_found


def latched(rig: Rig, code: str) -> Callable[[], bool]:
    return lambda: code in rig.loop.condition.latches


def let_go(rig: Rig) -> None:
    """Lowered, and its torque read back off."""
    until(rig, lambda: torque_off(rig.loop) is True, 1200)
    assert rig.loop.condition.state is RobotState.FAULT


# ------------------------------------------------------------------------------------ FOLLOW_ERR, OVERCURRENT


def test_follow_err_a_joint_that_something_holds_is_held_where_it_is(rig: Rig) -> None:
    """0.1 s after it is 0.2 rad, and what it may lag at this speed, behind; it is aimed at where it is."""
    place = rig.names.index("head_yaw")
    rig.virtual["main"].faults.lock(1)
    rig.lease()
    rig.submit(rig.path("head_yaw", [1.0], [1.0]), more=True)

    def behind() -> bool:
        allowed = 0.2 + 0.03 * abs(rig.loop.executor.reference.velocity[place])
        return bool(abs(rig.loop.robot.written[place] - rig.truth[place]) > allowed)

    until(rig, behind, 200)
    until(rig, latched(rig, "FOLLOW_ERR"), 10 + 1 + SLACK)
    assert rig.loop.condition.latches["FOLLOW_ERR"].joint == place
    assert rig.loop.condition.state is RobotState.FAULT
    rig.ticks(50)
    assert rig.loop.robot.written[place] == pytest.approx(rig.truth[place], abs=0.01)
    assert rig.loop.hardware.readings.load[place] < 0.1
    assert (rig.register("torque_enable") == 1).all()
    assert "SENSE_FROZEN" not in rig.loop.condition.latches
    assert rig.loop.executor.motion is Motion.HOLDING


def test_overcurrent_a_joint_at_full_load_is_reported_and_held(rig: Rig) -> None:
    """Locked, with a goal 0.15 rad away: not so far off that FOLLOW_ERR says anything."""
    place = rig.names.index("head_yaw")
    rig.virtual["main"].faults.lock(1)
    rig.lease()
    rig.submit(rig.path("head_yaw", [0.15], [1.0]), more=True)
    until(rig, lambda: rig.loop.hardware.readings.load[place] >= 0.8, 200)
    until(rig, is_reported(rig, "OVERCURRENT", place), 50 + LOOK + SLACK)
    until(rig, latched(rig, "OVERCURRENT"), 100 + LOOK + SLACK)
    rig.seconds(0.3)
    assert rig.loop.hardware.readings.load[place] < 0.1  # aimed at where it is, it pushes no more
    assert "SERVO_ALERT" not in rig.loop.condition.latches  # before it shut itself down


def test_a_frozen_encoder_is_distinguished_from_a_blocked_shaft(rig: Rig) -> None:
    nod(rig)
    place = rig.names.index("head_yaw")
    rig.virtual["main"].faults.freeze(1)
    until(rig, latched(rig, "SENSE_FROZEN"), 20 + LOOK + 1 + SLACK)
    assert rig.loop.condition.latches["SENSE_FROZEN"].joint == place
    assert (rig.loop.condition.state, rig.loop.executor.motion) == (RobotState.FAULT, Motion.HOLDING)


# ------------------------------------------------------------------------------------------- OVERTEMP


def heat(rig: Rig, celsius: float, id: int = 1) -> None:
    rig.virtual["main"].faults.heat(id, celsius)


def test_overtemp_a_motor_that_warms_up_goes_slower_then_the_robot_is_lowered(rig: Rig) -> None:
    """One degree every 0.2 s; each bound is told within a second of being reached."""
    nod(rig)
    crossed: dict[float, int] = {}
    seen: dict[float, int] = {}
    celsius = 57.0
    tick = 0
    while rig.loop.condition.state is RobotState.ARMED and tick < 1500:
        if tick % HEALTH == 0:
            celsius += 1.0
            heat(rig, celsius)
        rig.ticks(1)
        tick += 1
        warmth = float(rig.virtual["main"].servos.protection.celsius[0])
        bounds = {one.bound for event in rig.events("OVERTEMP") for one in event.findings}
        for bound in (60.0, 65.0, 70.0):
            if warmth >= bound - 0.5:
                crossed.setdefault(bound, tick)
            if bound in bounds:
                seen.setdefault(bound, tick)
        if seen.get(65.0) and tick > seen[65.0] + 1 and rig.loop.condition.state is RobotState.ARMED:
            assert rig.loop.executor.pace == 0.5
    assert rig.loop.condition.state is RobotState.FAULT
    for bound in (60.0, 65.0, 70.0):
        assert 0 < seen[bound] - crossed[bound] <= 100, (bound, seen, crossed)
    let_go(rig)
    assert is_reported(rig, "PACE")
    assert any("°C/s" in event.message for event in rig.events("OVERTEMP"))


def test_overtemp_prevents_arming_until_the_servo_is_cool(rig: Rig) -> None:
    heat(rig, 74.0)
    until(rig, latched(rig, "OVERTEMP"), VOTES + SLACK)
    let_go(rig)
    for celsius, arms in ((62.0, False), (57.0, False), (50.0, True)):
        heat(rig, celsius)
        rig.ticks(VOTES + SLACK)
        rig.lease()
        if rig.loop.condition.state is RobotState.FAULT:
            assert rig.call(link.Reset).error is None
        reply = rig.call(link.Arm)
        assert (reply.error is None) is arms, reply


# ------------------------------------------------------------------------------------------- VOLTAGE


def test_voltage_a_falling_supply_is_reported_lowers_the_robot_and_ends_damped(rig: Rig) -> None:
    """0.1 V every 0.2 s: each bound is answered 0.1 s, a reading and two ticks after it shows."""
    nod(rig)
    supply = rig.virtual["main"].faults.supply
    register = rig.virtual["main"].servos.memory.column("present_input_voltage", 2)
    volts = 11.6
    tick = 0
    crossed: dict[float, int] = {}
    seen: dict[float, int] = {}
    while rig.loop.condition.state is RobotState.ARMED and tick < 1000:
        if tick % HEALTH == 0:
            volts -= 0.1
            supply(volts)
        rig.ticks(1)
        tick += 1
        shown = register.get().min() / 10.0
        bounds = [one.bound for event in rig.events("VOLTAGE") for one in event.findings]
        for bound in (11.1, 10.5):
            if shown <= bound + 1e-9:
                crossed.setdefault(bound, tick)
            if any(abs(each - bound) < 1e-6 for each in bounds):
                seen.setdefault(bound, tick)
    assert rig.loop.condition.state is RobotState.FAULT
    for bound in (11.1, 10.5):
        assert 0 < seen[bound] - crossed[bound] <= 10 + HEALTH + SLACK, (bound, seen, crossed)
    supply(10.4)
    let_go(rig)


def test_voltage_where_nothing_can_be_held_any_more_the_robot_is_soft_at_once(rig: Rig) -> None:
    nod(rig)
    rig.virtual["main"].faults.supply(9.8)
    until(rig, latched(rig, "VOLTAGE"), 10 + 10 + HEALTH + SLACK)  # the registers follow within 0.1 s
    assert rig.loop.condition.latches["VOLTAGE"].bound == pytest.approx(10.0)
    until(rig, lambda: bool(rig.events("DAMP")), 10)
    let_go(rig)


# ------------------------------------------------------------------------------------------- TIME_GAP


def stopped(rig: Rig, seconds: float, slept: float = 0.0) -> None:
    """The daemon is stopped, or the machine sleeps, between two ticks."""
    rig.clock.sleep_until(rig.clock.now() + seconds)
    rig.clock.slept += slept


@pytest.mark.parametrize(("seconds", "slept"), [(0.2, 0.0), (5.0, 0.0), (0.0, 30.0)])
def test_a_gap_is_a_fault_and_no_goal_of_before_leaves_after_it(
    rig: Rig, seconds: float, slept: float
) -> None:
    nod(rig)
    before = rig.loop.robot.written.copy()
    stopped(rig, seconds, slept)
    rig.ticks(1)
    assert rig.loop.condition.state is RobotState.FAULT
    assert "TIME_GAP" in rig.loop.condition.latches
    assert rig.loop.robot.written == pytest.approx(before, abs=1e-12)
    rig.ticks(100)
    assert rig.loop.executor.motion is Motion.HOLDING
    assert rig.loop.robot.written == pytest.approx(before, abs=0.02)
    assert rig.call(link.Arm).error is not None
    assert rig.call(link.Disarm, ticks=1500).error is None
    assert rig.call(link.Reset).error is None
    rig.lease()
    assert rig.call(link.Arm).error is None


# ------------------------------------------------------------------------------------------- nothing


def full_speed(rig: Rig, joint: int) -> Trajectory:
    """One joint there and back, with all the acceleration and speed it may have."""
    limits = rig.loop.robot.limits
    here = rig.loop.executor.reference.position
    up = limits.upper[joint] - 0.1 - here[joint]
    down = here[joint] - limits.lower[joint] - 0.1
    far = min(1.0, up) if up >= down else -min(1.0, down)
    speed = float(limits.velocity[joint])
    accel = float(limits.acceleration[joint])
    size = abs(far)
    top = min(0.999 * speed, (0.999 * accel * size) ** 0.5)
    ramp = top / (0.999 * accel)
    cruise = max(size / top - ramp, 0.0)
    half = np.arange(0.01, 2 * ramp + cruise + 0.2, 0.01)
    t = np.minimum(half, 2 * ramp + cruise)
    way = np.where(
        t < ramp,
        0.5 * top / ramp * t**2,
        np.where(
            t < ramp + cruise, top * (t - 0.5 * ramp), size - 0.5 * top / ramp * (2 * ramp + cruise - t) ** 2
        ),
    )
    place = here[joint] + np.sign(far) * np.concatenate([way, size - way])
    rows = np.tile(here, (len(place), 1))
    rows[:, joint] = place
    commanded = np.zeros(len(here), np.bool_)
    commanded[joint] = True
    return Trajectory(np.arange(1, len(place) + 1) * 0.01, rows, commanded)


TRIPS = {
    "FOLLOW_ERR",
    "SENSE_FROZEN",
    "SENSE_JUMP",
    "OVERSPEED",
    "OVERCURRENT",
    "OVERTEMP",
    "VOLTAGE",
    "TIME_GAP",
}


@pytest.mark.parametrize(
    "joints",
    [(0, 2, 11, 14), pytest.param(tuple(range(24)), marks=pytest.mark.slow)],
    ids=["some", "all"],
)
def test_a_joint_at_full_speed_trips_nothing(rig: Rig, joints: tuple[int, ...]) -> None:
    for joint in joints:
        if rig.names[joint].endswith("hip_yaw"):
            continue  # the feet would meet: LOOKAHEAD_COLLISION slows it, or holds
        rig.lease()
        rig.loop.commands.submissions.epoch = rig.loop.parts.lease.epoch
        assert rig.loop.executor.submit("full", full_speed(rig, joint)) is None
        fastest = 0.0
        while rig.loop.executor.motion is Motion.ACTIVE:
            rig.ticks(1)
            rig.loop.parts.lease.renew(7, rig.clock.now())
            fastest = max(fastest, abs(float(rig.loop.robot.measured.velocity[joint])))
        assert fastest > 1.5  # rad/s; the way of some is too short for more
    assert not {event.code for event in rig.events()} & TRIPS
    assert rig.loop.condition.state is RobotState.ARMED


@pytest.mark.parametrize("name", ["reach", "squat", pytest.param("wave", marks=pytest.mark.slow)])
def test_a_built_in_motion_as_fast_as_it_may_be_trips_nothing(rig: Rig, name: str) -> None:
    """Three times as fast as it stands in its file, and slowed down by the gate to what the limits allow."""
    motion = json.loads((rig.robot.motions / f"{name}.json").read_text())
    points = motion["points"]
    places = [rig.names.index(joint) for joint in motion["joint_names"]]
    position = np.zeros((len(points), len(rig.names)))
    position[:, places] = [point["positions"] for point in points]
    velocity = np.zeros_like(position) if "velocities" in points[0] else None
    if velocity is not None:
        velocity[:, places] = [np.array(point["velocities"]) / 0.3 for point in points]
    commanded = np.zeros(len(rig.names), np.bool_)
    commanded[places] = True
    time = np.array([0.3 * point["time_from_start"] for point in points])
    rig.lease()
    ticket = rig.submit(Trajectory(time, position, commanded, velocity), policy="retime", more=True)
    until(rig, lambda: any(not reply.continues for reply in rig.replies(ticket)), 1500)
    assert rig.replies(ticket)[-1].parameters["phase"] == "succeeded"
    assert not {event.code for event in rig.events()} & (TRIPS | {"MIRROR_DRIFT"})
