"""Reactions of the whole loop to a decision: the ladder HOLD, SETTLE, DAMP; pace; holding where measured."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from tests.support.described_robot import redescribe
from tests.support.reaction_rig import PWM, P, injected_findings, raised, soft
from twind import link
from twind.config.robot_file import load_robot
from twind.loop.procedures import damping, lowering
from twind.loop.procedures.torque_readback import torque_off
from twind.robot.modes import Motion
from twind.safety.guard import FINE
from twind.safety.guard_types import Reaction
from twind.twin.mujoco_physics import body_of
from twind.virtual.virtual_robot_spec import make_spec
from twind_drivers.dynamixel.damping import SHARE

pytestmark = pytest.mark.slow  # whole lives of the loop: half of all fast tests' time


def unjudged(rig: Rig) -> None:
    """The rules fall silent: what is tested is what the loop does, not what made it."""
    rig.loop.parts.guard.judge = lambda _: FINE  # type: ignore[method-assign]


def steps(rig: Rig, ticks: int) -> np.ndarray:
    """Goals (k, n) of `ticks` ticks; each within one step of the last (W3)."""
    rows = [rig.loop.robot.written]
    for _ in range(ticks):
        rig.ticks(1)
        rows.append(rig.loop.robot.written)
    track = np.array(rows)
    most = rig.loop.robot.limits.velocity * rig.loop.robot.period
    assert (np.abs(np.diff(track, axis=0)) <= most + 1e-9).all()
    return track


# ------------------------------------------------------------------------------------------- DAMP


def test_a_damped_robot_is_soft_with_torque_on_then_off(armed: Rig) -> None:
    raised(armed)
    with injected_findings(armed, reaction=Reaction.DAMP, latches=True):
        steps(armed, 1)
    steps(armed, 20)
    assert soft(armed)
    assert (armed.register("torque_enable") == 1).all()
    assert armed.loop.condition.state == "fault"
    armed.seconds(damping.SLOW_FOR + 0.3)
    assert (armed.register("torque_enable") == 0).all()
    assert torque_off(armed.loop)
    assert (armed.loop.torque.soft_since, armed.loop.torque.armed) == (None, False)
    assert [event.level for event in armed.events("DAMP")] == ["error"]


def test_a_robot_that_never_rests_is_let_go_after_five_seconds(armed: Rig) -> None:
    with injected_findings(armed, reaction=Reaction.DAMP, latches=True):
        armed.ticks(1)
    began = armed.clock.now()
    shake = armed.loop.hardware.readings
    while armed.loop.torque.armed:
        shake.velocity[:] = 0.2
        state = armed.loop.robot.measured
        armed.loop.robot.measured = replace(state, velocity=state.velocity * 0.0 + 0.2)
        armed.ticks(1)
        assert armed.clock.now() < began + 6.0
    assert armed.clock.now() - began == pytest.approx(damping.SLOW_MOST, abs=0.1)
    armed.seconds(0.3)
    assert (armed.register("torque_enable") == 0).all()


@pytest.mark.parametrize("begin", ["disarm", "settle", "estop", "shutdown"])
def test_damp_takes_every_way_down_over_and_none_takes_it_over(armed: Rig, begin: str) -> None:
    raised(armed)
    if begin == "disarm":
        armed.send(link.Disarm)
    elif begin == "estop":
        armed.send(link.EStop, level="settle", reason="test")
    elif begin == "shutdown":
        armed.loop.condition.stop_wanted = True
    else:
        with injected_findings(armed, reaction=Reaction.SETTLE, latches=True):
            armed.ticks(1)
    steps(armed, 20)
    assert armed.loop.executor.motion is Motion.ACTIVE
    with injected_findings(armed, reaction=Reaction.DAMP, latches=True):
        steps(armed, 1)
    steps(armed, 30)
    assert soft(armed)
    high = armed.loop.robot.written[armed.names.index("l_shoulder_pitch")]  # type: ignore[index]
    with injected_findings(armed, reaction=Reaction.SETTLE, latches=True):
        armed.send(link.EStop, level="settle", reason="again")
        steps(armed, 30)
    assert soft(armed)
    assert armed.loop.executor.motion is Motion.HOLDING, "no way to the rest pose any more"
    now = armed.loop.robot.written[armed.names.index("l_shoulder_pitch")]  # type: ignore[index]
    assert now == pytest.approx(high, abs=0.05), "joints without load stay where they are"
    armed.seconds(6.0)
    assert torque_off(armed.loop)
    assert (armed.register("torque_enable") == 0).all()


def test_a_hold_does_not_end_a_damping(armed: Rig) -> None:
    raised(armed)
    with injected_findings(armed, reaction=Reaction.DAMP, latches=True):
        armed.ticks(1)
    with injected_findings(armed, reaction=Reaction.HOLD, here=(3,)):
        armed.ticks(20)
    assert soft(armed)
    assert armed.loop.torque.soft_since is not None
    armed.seconds(2.0)
    assert torque_off(armed.loop)


def test_a_cut_overtakes_a_damping(armed: Rig) -> None:
    with injected_findings(armed, reaction=Reaction.DAMP, latches=True):
        armed.ticks(1)
    reply = armed.call(link.EStop, level="cut", reason="test", ticks=20)
    assert reply.error is None
    assert (armed.register("torque_enable") == 0).all()


def test_an_e_stop_of_a_damped_robot_is_answered_when_every_servo_is_soft(armed: Rig) -> None:
    raised(armed)
    with injected_findings(armed, reaction=Reaction.DAMP, latches=True):
        armed.ticks(1)
    reply = armed.call(link.EStop, reason="test", ticks=50)
    assert reply.error is None
    assert reply.parameters["done"] is False
    assert soft(armed)


def test_a_servo_without_replies_is_named_and_delays_no_other(armed: Rig) -> None:
    raised(armed)
    armed.virtual["main"].faults.silence(7, on=True)
    with injected_findings(armed, reaction=Reaction.DAMP, latches=True):
        armed.ticks(1)
    armed.seconds(0.6)
    others = np.arange(24) != 6
    assert (armed.register("goal_pwm")[others] == int(SHARE * PWM)).all()
    assert any("7" in event.message for event in armed.events("DAMP")[1:])
    armed.seconds(6.0)
    assert (armed.register("torque_enable")[others] == 0).all()


def test_arming_after_a_damping_gives_the_strength_back(armed: Rig) -> None:
    with injected_findings(armed, reaction=Reaction.DAMP, latches=True):
        armed.ticks(1)
    armed.seconds(2.0)
    assert soft(armed)
    assert armed.call(link.Reset).error is None
    armed.lease()
    assert armed.call(link.Arm).error is None
    assert (armed.register("goal_pwm") == PWM).all()
    assert (armed.register("position_p_gain") == P).all()
    assert (armed.register("position_d_gain") == 0).all()


# ------------------------------------------------------------------------------------------- how it sinks


def mujoco_rig() -> Rig:
    robot = load_robot("h24")
    body = body_of(robot, make_spec(robot).zeros, now=100.0)
    kind: Any = lambda ticks, now: body.part(range(24))  # noqa: E731
    return Rig(muscles=kind)


def fall(rig: Rig, seconds: float) -> tuple[float, float]:
    """Fastest speed (rad/s) of the raised joint, and how far it came (rad)."""
    place = rig.names.index("l_shoulder_pitch")
    track = []
    for _ in range(round(seconds / rig.loop.robot.period)):
        rig.ticks(1)
        track.append(rig.truth[place])
    return float(np.abs(np.diff(track)).max() / rig.loop.robot.period), abs(track[-1] - track[0])


def test_a_raised_arm_sinks_slowly_where_torque_off_drops_it() -> None:
    results = {}
    for way in ("damp", "cut"):
        rig = mujoco_rig()
        try:
            rig.arm()
            raised(rig)
            if way == "damp":
                with injected_findings(rig, reaction=Reaction.DAMP, latches=True):
                    rig.ticks(1)
            else:
                rig.send(link.EStop, level="cut", reason="test")
            results[way] = fall(rig, 1.5)
        finally:
            rig.close()
    (slow, sank), (quick, dropped) = results["damp"], results["cut"]
    assert sank > 0.08, "it does not stay up"
    assert slow < 0.2
    assert dropped > 0.8
    assert quick > 5.0 * slow


# ------------------------------------------------------------------------------------------- SETTLE


def test_an_estop_that_cannot_settle_is_damped_within_four_seconds_and_let_go(armed: Rig) -> None:
    """`support: free`, and something holds the arm up: not at rest in the rest pose after 4 s."""
    redescribe(armed.loop, support="free")
    raised(armed)
    unjudged(armed)
    armed.virtual["main"].faults.lock(3)
    armed.send(link.EStop, level="settle", reason="test")
    began = armed.clock.now()
    while armed.loop.torque.soft_since is None:
        armed.ticks(1)
        assert armed.clock.now() <= began + lowering.SETTLE + 0.05
    assert armed.clock.now() - began > 3.0
    armed.seconds(damping.SLOW_FOR + 0.3)
    assert torque_off(armed.loop)
    assert armed.clock.now() - began < lowering.SETTLE + damping.SLOW_MOST + 0.5


@pytest.mark.parametrize("support", ["fixed", "gantry", "free"])
def test_an_e_stop_switches_torque_off_within_four_seconds(armed: Rig, support: str) -> None:
    redescribe(armed.loop, support=support)
    raised(armed)
    assert armed.submit(armed.path("l_shoulder_pitch", [1.0], [3.0]), more=True)
    armed.seconds(1.5)
    before = armed.loop.executor.reference
    armed.send(link.EStop, level="settle", reason="test")
    armed.ticks(1)
    after = armed.loop.executor.reference
    assert before is not None
    assert after is not None
    place = armed.names.index("l_shoulder_pitch")
    assert abs(after.velocity[place]) < abs(before.velocity[place]), "the next goal decelerates (W6)"
    armed.seconds(lowering.SETTLE)
    assert (armed.register("torque_enable") == 0).all()
    assert torque_off(armed.loop)
    assert not armed.events("DAMP")


@pytest.mark.parametrize("support", ["fixed", "free", "hovering"])
def test_a_way_that_is_interrupted_is_damped(armed: Rig, support: str) -> None:
    redescribe(armed.loop, support=support)
    raised(armed)
    armed.send(link.Disarm)
    for _ in range(40):
        armed.ticks(10)
        armed.loop.executor.stop()  # as a HOLD in the middle of it
        if armed.loop.torque.soft_since is not None:
            break
    assert armed.loop.torque.soft_since is not None
    armed.ticks(20)
    assert soft(armed)
    armed.seconds(2.0)
    assert torque_off(armed.loop)
    assert armed.loop.condition.state == "connected"


@pytest.mark.parametrize(("support", "damped"), [("free", True), ("gantry", False)])
def test_sigterm_on_a_free_robot_switches_torque_off_only_at_rest(
    armed: Rig, support: str, damped: bool
) -> None:
    redescribe(armed.loop, support=support)
    raised(armed)
    unjudged(armed)
    armed.virtual["main"].faults.lock(3)
    armed.loop.condition.stop_wanted = True
    for _ in range(1200):
        armed.loop.condition.stop_wanted = True  # a second signal, and a third: nothing is cut short
        armed.ticks(1)
        if armed.loop.condition.finished:
            break
    assert armed.loop.condition.finished
    assert bool(armed.events("DAMP")) == damped
    assert (armed.register("torque_enable") == 0).all()


def test_a_settle_that_latches_nothing_ends_disarmed(armed: Rig) -> None:
    with injected_findings(armed, reaction=Reaction.SETTLE):
        armed.ticks(1)
    assert armed.loop.condition.state == "settling"
    armed.seconds(lowering.SETTLE)
    assert armed.loop.condition.state == "connected"
    assert not armed.loop.torque.armed


# ------------------------------------------------------------------------------------------- HOLD, pace


def test_a_named_joint_is_held_where_it_is_and_the_others_as_commanded(armed: Rig) -> None:
    raised(armed)
    unjudged(armed)
    armed.submit(armed.path("l_shoulder_pitch", [0.0], [2.0]), more=True)
    armed.seconds(0.5)
    armed.virtual["main"].faults.lock(3)
    steps(armed, 20)
    place = armed.names.index("l_shoulder_pitch")
    away = armed.loop.robot.written[place] - armed.truth[place]  # type: ignore[index]
    assert abs(away) > 0.1
    held = armed.loop.executor.reference
    with injected_findings(armed, reaction=Reaction.HOLD, here=(place,)):
        steps(armed, 2)
    track = steps(armed, 100)
    assert held is not None
    assert track[-1][place] == pytest.approx(armed.truth[place], abs=0.01)
    others = np.arange(24) != place
    assert track[-1][others] == pytest.approx(held.position[others], abs=1e-9)
    assert armed.loop.executor.motion is Motion.HOLDING


def test_a_joint_beyond_its_hard_limit_is_held_at_that(armed: Rig) -> None:
    place = armed.names.index("l_elbow")
    beyond = armed.loop.robot.measured.position.copy()
    beyond[place] = armed.loop.robot.limits.hard_upper[place] + 0.3
    unjudged(armed)
    armed.loop.robot.measured = replace(armed.loop.robot.measured, position=beyond)
    with injected_findings(armed, reaction=Reaction.HOLD, here=(place,)):
        armed.loop.reactions.react(armed.loop.parts.guard.judge(None), None, armed.clock.now())  # type: ignore[arg-type]
    track = steps(armed, 100)
    hard = armed.loop.robot.limits.hard_upper[place]
    tick = armed.loop.hardware.resolution[place]
    assert hard - tick <= track[-1][place] <= hard, "the last place that a goal may have"
    assert armed.loop.condition.state == "armed", "and every goal left"


def test_a_joint_whose_place_is_unknown_stays_where_it_was_commanded(armed: Rig) -> None:
    before = armed.loop.robot.written
    armed.loop.executor.give_in([0], armed.loop.robot.measured.position * np.nan)
    assert steps(armed, 20)[-1] == pytest.approx(before)


def test_a_pace_reaction_slows_the_robot_is_reported_once_and_restores_its_speed(armed: Rig) -> None:
    place = armed.names.index("l_shoulder_pitch")
    ticket = armed.submit(armed.path("l_shoulder_pitch", [1.2], [3.0]), more=True)
    armed.seconds(1.0)
    with injected_findings(armed, pace=0.25, findings=()):
        steps(armed, 50)
        slow = np.diff(steps(armed, 50)[:, place]) / armed.loop.robot.period
        assert np.abs(slow).max() <= 0.3 * 1.2 / 3.0 * 2.0
    steps(armed, 300)
    assert armed.replies(ticket)[-1].parameters["phase"] == "succeeded"
    assert armed.loop.robot.written[place] == pytest.approx(1.2)  # type: ignore[index]
    assert len(armed.events("PACE")) == 1


def test_the_way_to_the_rest_pose_is_never_slowed(armed: Rig) -> None:
    raised(armed)
    with injected_findings(armed, pace=0.1, findings=()):
        armed.send(link.EStop, level="settle", reason="test")
        armed.seconds(lowering.SETTLE)
    assert torque_off(armed.loop)


# ------------------------------------------------------------------------------------- a hold that lasts


@pytest.mark.parametrize(
    ("support", "lowered"),
    [
        ("free", True),
        pytest.param("gantry", False, marks=pytest.mark.slow),
        pytest.param("fixed", False, marks=pytest.mark.slow),
    ],
)
def test_a_hold_of_thirty_seconds_lowers_what_stands_freely_alone(
    make_rig: MakeRig, support: str, lowered: bool
) -> None:
    rig = make_rig(support=support, rate_hz=25.0)  # the bound is in seconds, whatever the rate
    rig.arm()
    rig.submit(rig.path("l_shoulder_pitch", [-1.5], [3.0]), more=False)
    rig.seconds(2.0)
    assert rig.events("LEASE_LOST"), "nobody renewed it: held"
    rig.seconds(29.0)
    assert rig.loop.torque.armed
    assert rig.loop.executor.motion is Motion.HOLDING
    rig.seconds(6.0)
    assert torque_off(rig.loop) is lowered
    assert (rig.register("torque_enable") == (0 if lowered else 1)).all()
    assert not rig.events("DAMP")
