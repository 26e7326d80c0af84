"""Recovery is explicit (X1): whatever latched, in whatever state, mode and motion, nothing moves again and no
torque comes on before somebody has reset and armed. What was asked before is gone."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from tests.support.reaction_rig import injected_findings
from twind import link
from twind.loop.procedures.torque_readback import torque_on
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion
from twind.safety.guard_types import Reaction

JOINT = "l_shoulder_pitch"
SAMPLE = ReasonCode.FOLLOW_ERR  # in every situation; of the others each fourth in one, in turn


def hold_still(rig: Rig) -> None:
    rig.arm()


def move(rig: Rig) -> None:
    rig.arm()
    rig.submit(rig.path(JOINT, [0.8], [2.0]), more=True)
    rig.seconds(0.5)
    assert rig.loop.executor.motion is Motion.ACTIVE


def wait_for_a_start(rig: Rig) -> None:
    rig.arm()
    rig.submit(rig.path(JOINT, [0.8], [2.0]), more=True, start_in=0.6)
    rig.ticks(20)


def stream(rig: Rig) -> None:
    rig.arm()
    place = rig.names.index(JOINT)
    for step in range(5):
        rig.send(link.Setpoint, joints=[place], positions=[0.01 * step], valid_for=0.1, velocities=None)
        rig.ticks(2)
    assert rig.loop.executor.motion is Motion.STREAMING


def settle(rig: Rig) -> None:
    move(rig)
    rig.send(link.Disarm)
    rig.ticks(10)
    assert rig.loop.condition.state == "settling"


def connect(rig: Rig) -> None:
    rig.connect()
    rig.lease()


def arm_half_way(rig: Rig) -> None:
    connect(rig)
    rig.send(link.Arm)
    rig.ticks(6)
    assert rig.loop.condition.state == "arming"


SITUATIONS = (hold_still, move, wait_for_a_start, stream, settle, connect, arm_half_way)
CASES = [(SAMPLE, situation) for situation in SITUATIONS] + [
    pytest.param(code, SITUATIONS[number % len(SITUATIONS)], marks=pytest.mark.slow)
    for number, code in enumerate(list(ReasonCode)[::4])
]


def everything(rig: Rig) -> list[int]:
    """Send motion, setpoints, torque, registers and modes, as an impatient client does."""
    rig.send(link.AcquireLease, take=True)
    place = rig.names.index(JOINT)
    tickets = [rig.submit(rig.path(JOINT, [0.3], [1.0]))]
    tickets.append(rig.send(link.Setpoint, joints=[place], positions=[0.2], valid_for=0.1, velocities=None))
    tickets.append(rig.send(link.Arm))
    tickets.append(rig.send(link.SetMode, mode="mirror"))
    for name, value in (("Torque Enable", 1), ("Goal Position", 2048)):
        tickets.append(rig.send(link.WriteRegister, bus="main", id=3, name=name, value=value))
    rig.send(link.RenewLease)
    return tickets


def torques(rig: Rig) -> np.ndarray:
    return rig.register("torque_enable") == 1


def watch(rig: Rig, ticks: int, ask: int = 8) -> None:
    """Torque never comes on, and goals come to rest where the robot holds and stay there."""
    on = torques(rig)
    tickets: list[int] = []
    for tick in range(ticks):
        if tick % ask == 0:
            tickets += everything(rig)
        rig.ticks(1)
        now = torques(rig)
        assert not (now & ~on).any(), "torque came on"
        on = now
    for ticket in tickets:
        answers = [reply for reply in rig.replies(ticket) if not reply.continues]
        assert answers[-1].error is not None, answers


@pytest.mark.parametrize(("code", "situation"), CASES)
def test_a_latch_holds_until_an_explicit_reset_and_arm(
    live: Rig, code: ReasonCode, situation: Callable[[Rig], None]
) -> None:
    situation(live)
    why = (Finding(code, message="latched by the test"),)
    with injected_findings(live, reaction=Reaction.HOLD, latches=True, findings=why, causes=why):
        live.ticks(1)
    assert live.loop.condition.state == "fault"
    assert code in live.loop.condition.latches
    watch(live, 60)
    assert live.loop.executor.motion in (Motion.HOLDING, Motion.IDLE, Motion.ACTIVE)
    if situation is not settle:
        assert live.loop.executor.motion is not Motion.ACTIVE
        held = live.register("goal_position").copy()
        watch(live, 60)
        assert np.array_equal(live.register("goal_position"), held)
    recover(live, code)


def recover(rig: Rig, code: ReasonCode) -> None:
    """The way out: disarm, reset, arm; none of them alone."""
    if torque_on(rig.loop):
        assert rig.call(link.Reset).error == "WrongState"
    assert rig.call(link.Disarm, ticks=600).error in (None, "Busy")
    rig.seconds(0.5)
    assert not torques(rig).any()
    assert rig.loop.condition.state == "fault"
    assert "FAULT_LATCHED" in codes(rig.call(link.Arm))
    assert rig.call(link.Reset, codes=[code.value]).error is None
    assert code not in rig.loop.condition.latches
    assert not rig.loop.torque.armed
    rig.ticks(50)
    assert not torques(rig).any(), "a reset never arms"
    before = rig.counts.copy()
    rig.call(link.AcquireLease, take=True)
    assert rig.call(link.Arm).error is None
    rig.seconds(1.0)
    assert np.abs(rig.counts - before).max() <= 2, "what was asked before is gone"


def codes(reply: link.Reply) -> list[str]:
    return [finding["code"] for finding in reply.parameters.get("findings", ())]


@pytest.mark.parametrize("reaction", [Reaction.SETTLE, Reaction.DAMP, Reaction.INHIBIT])
def test_harder_reactions_end_without_torque_or_without_a_word_and_stay_so(
    armed: Rig, reaction: Reaction
) -> None:
    armed.submit(armed.path(JOINT, [0.8], [2.0]), more=True)
    armed.seconds(0.5)
    with injected_findings(armed, reaction=reaction, latches=True):
        armed.ticks(1)
    watch(armed, 600, ask=50)
    if reaction is Reaction.INHIBIT:
        assert armed.loop.condition.state == "inhibited"
        assert torques(armed).all(), "torque stays, the watchdogs have stopped the motion"
    else:
        assert armed.loop.condition.state == "fault"
        assert not torques(armed).any()


@pytest.mark.parametrize("mode", [Mode.SIM, Mode.MIRROR])
def test_without_a_bus_to_write_to_a_latch_stops_the_simulation_until_reset(
    make_rig: MakeRig, mode: Mode
) -> None:
    rig = make_rig(mode=mode)
    rig.seconds(1.0)
    goals = rig.register("goal_position").copy()
    rig.lease()
    rig.submit(rig.path(JOINT, [0.8], [2.0]), more=True)
    rig.seconds(0.5)
    rig.call(link.EStop, reason="test")
    place = rig.loop.robot.simulated.position.copy()
    for _ in range(10):
        rig.submit(rig.path(JOINT, [0.3], [1.0]))
        rig.ticks(10)
    assert rig.loop.robot.simulated.position == pytest.approx(place, abs=0.05)
    assert not torques(rig).any()
    assert np.array_equal(rig.register("goal_position"), goals)


def test_a_robot_whose_joint_lost_a_turn_is_not_armed(live: Rig) -> None:
    """Row 20: a count is one turn off, and nothing in its registers says so."""
    live.connect()
    live.lease()
    live.virtual["main"].servos.muscles.position[6] += 4096
    live.ticks(5)
    reply = live.call(link.Arm)
    assert codes(reply) == ["CALIB_MISMATCH"]
    assert reply.parameters["findings"][0]["joint"] == 6
    assert "-1 turns from where it was calibrated" in reply.parameters["findings"][0]["message"]
    assert not torques(live).any()


@pytest.mark.parametrize("away", [0.05, 0.3, 2.0, 30.0])
def test_a_daemon_that_stood_still_sends_no_burst_of_old_goals(armed: Rig, away: float) -> None:
    """Rows 25, 30: the goals go on from where they were, or are held; the servos that stopped stay."""
    armed.submit(armed.path(JOINT, [0.8], [2.0]), more=True)
    armed.seconds(1.0)
    before = armed.loop.robot.written
    assert before is not None
    armed.clock.sleep_until(armed.clock.now() + away)
    armed.ticks(1)
    stood = armed.counts.copy()
    goals = [armed.loop.robot.written]
    for _ in range(200):
        armed.ticks(1)
        goals.append(armed.loop.robot.written)
    track = np.array([before, *goals])
    assert (
        np.abs(np.diff(track, axis=0)) <= armed.loop.robot.limits.velocity * armed.loop.robot.period + 1e-9
    ).all()
    if away > 0.1:
        assert armed.loop.condition.state == "fault"
        assert np.abs(armed.counts - stood).max() <= 2
        assert {"WATCHDOG_TRIPPED"} <= set(armed.loop.condition.latches)


def test_commands_queued_before_an_unplug_are_dropped_before_the_replug(armed: Rig) -> None:
    """Goals, a start to come, register writes: none of it reaches the servos that are back."""
    armed.submit(armed.path(JOINT, [0.8], [2.0]), more=True)
    armed.seconds(0.5)
    late = armed.submit(armed.path(JOINT, [0.3], [1.0]), more=True, start_in=1.5)
    writes = [
        armed.send(link.WriteRegister, client=9, bus="main", id=id, name="Profile Velocity", value=77)
        for id in range(1, 13)
    ]
    armed.ticks(1)
    armed.virtual["main"].faults.unplug()
    armed.ticks(5)
    written = armed.register("profile_velocity").copy()
    armed.virtual["main"].faults.replug(renamed=True)
    armed.seconds(0.3)  # the watchdogs have stopped what moved
    goals = armed.register("goal_position").copy()
    places = armed.counts.copy()
    armed.seconds(3.0)
    assert armed.loop.condition.state == "fault"
    assert not armed.loop.torque.armed
    assert np.array_equal(armed.register("goal_position"), goals)
    assert np.abs(armed.counts - places).max() <= 2
    assert np.array_equal(armed.register("profile_velocity"), written)
    assert all(armed.replies(ticket)[-1].error is not None for ticket in writes[-3:])
    assert armed.replies(late)[-1].parameters["phase"] == "aborted"
