"""The whole loop detects faults of buses and servos in time: threshold + refresh + 2 ticks."""

from collections.abc import Callable

import numpy as np

from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.loop.bus.bus_port import PortState
from twind.robot.modes import Motion, RobotState

HEALTH = 20  # ticks between two readings of a servo's own clock (docs/reason-codes.md)
PROBE = 110  # ticks until a servo that was silent for a moment is asked again, its boot included
OVERLOAD = 0b100000


def on(rig: Rig) -> np.ndarray:
    return rig.register("torque_enable") == 1


def until(rig: Rig, what: Callable[[], bool], ticks: int) -> int:
    """Return the number of ticks until it holds; fail after `ticks`."""
    for count in range(1, ticks + 1):
        rig.ticks(1)
        if what():
            return count
    raise AssertionError(
        f"not within {ticks} ticks: {rig.loop.condition.state}, {[e.message for e in rig.events()]}"
    )


def latched(rig: Rig, code: str) -> Callable[[], bool]:
    return lambda: code in rig.loop.condition.latches


def move(rig: Rig) -> None:
    rig.submit(rig.path("head_yaw", [1.0], [4.0]), more=True)
    rig.ticks(20)
    assert rig.loop.executor.motion is Motion.ACTIVE


# ----------------------------------------------------------------------------------------------- BUS_ERRORS


def test_bus_errors_a_noisy_line_holds_the_robot_and_keeps_its_torque(armed: Rig) -> None:
    move(armed)
    armed.virtual["main"].faults.bit_errors(0.1, to_servos=False)
    until(armed, lambda: armed.loop.executor.motion is Motion.HOLDING, 5 + 2)
    until(armed, latched(armed, "BUS_ERRORS"), 20 + 2)
    assert armed.loop.condition.state is RobotState.FAULT
    assert "bus main" in armed.loop.condition.latches["BUS_ERRORS"].message
    assert on(armed).all()


def test_bus_errors_one_broken_answer_at_a_low_rate_ends_no_motion(make_rig: MakeRig) -> None:
    rig = make_rig(rate_hz=20.0)
    rig.arm()
    assert rig.events("STATE_STALE") == []  # 47 ms old when the tick begins, and not late at all
    rig.lease()
    rig.submit(rig.path("head_yaw", [1.0], [4.0]), more=True)
    rig.seconds(0.5)
    rig.virtual["main"].faults.corrupt(1)
    rig.seconds(0.5)
    assert rig.events("BUS_ERRORS")
    assert rig.loop.executor.motion is Motion.ACTIVE


def test_bus_errors_one_silent_servo_is_no_matter_of_the_bus(armed: Rig) -> None:
    armed.virtual["main"].faults.silence(7)
    armed.seconds(0.4)
    assert "BUS_ERRORS" not in armed.loop.condition.latches
    until(armed, latched(armed, "STATE_STALE"), 20)


# -------------------------------------------------------------------------------------------- FOREIGN_TRAFFIC


def test_foreign_traffic_on_the_bus_of_an_armed_robot_inhibits(armed: Rig) -> None:
    move(armed)
    armed.virtual["main"].faults.foreign(3)
    until(armed, latched(armed, "FOREIGN_TRAFFIC"), 3 + 2)
    assert armed.loop.condition.state is RobotState.INHIBITED
    assert armed.loop.publisher.overview(armed.clock.now()).latched == ["FOREIGN_TRAFFIC"]
    armed.seconds(0.5)
    assert (armed.register("bus_watchdog") == 255).all()  # nothing was sent: their watchdogs ended the motion
    assert on(armed).all()
    assert armed.loop.robot.measured.heard.all()  # reading resumes
    assert len(armed.events("FOREIGN_TRAFFIC")) <= 2


def test_foreign_traffic_prevents_arming(live: Rig) -> None:
    live.connect()
    live.lease()

    def reported() -> list[str]:
        overview = live.loop.publisher.overview(live.clock.now())
        assert overview.latched == []
        return [str(each.code) for each in overview.faults]

    assert reported() == []
    live.virtual["main"].faults.foreign(3)
    live.ticks(6)
    reply = live.call(link.Arm)
    assert [each["code"] for each in reply.parameters["findings"]] == ["FOREIGN_TRAFFIC"]
    assert live.loop.condition.latches == {} and reported() == ["FOREIGN_TRAFFIC"], "the status says why, too"
    live.seconds(1.1)
    live.lease()
    assert reported() == []
    assert live.call(link.Arm).error is None


# ----------------------------------------------------------------------------------------------- SERVO_ALERT


def test_servo_alert_a_servo_that_shuts_down_latches_within_two_ticks_with_its_cause(armed: Rig) -> None:
    move(armed)
    armed.virtual["main"].faults.damage(9, OVERLOAD)
    until(armed, latched(armed, "SERVO_ALERT"), 2)
    assert "overload" in armed.loop.condition.latches["SERVO_ALERT"].message
    assert armed.loop.condition.latches["SERVO_ALERT"].joint == armed.loop.robot.joints.buses[0].ids.index(9)
    assert armed.loop.condition.state is RobotState.FAULT
    armed.seconds(0.5)
    assert armed.loop.executor.motion is Motion.HOLDING
    assert on(armed).sum() == 23  # a gantry carries what hangs: the others hold


def test_servo_alert_a_latched_alert_gives_its_cause_once_it_is_read(armed: Rig) -> None:
    slow = armed.loop.hardware.slow
    joint = 8
    armed.virtual["main"].faults.damage(9, OVERLOAD)
    armed.ticks(1)
    slow.fault[joint] = 0  # as if there had been no room for the question in this tick
    armed.ticks(1)
    assert "not read yet" in armed.loop.condition.latches["SERVO_ALERT"].message
    until(armed, lambda: "overload" in armed.loop.condition.latches["SERVO_ALERT"].message, 8)


# --------------------------------------------------------------------------------------------- SERVO_REBOOTED


def test_servo_rebooted_a_brown_out_is_a_fault_and_nothing_is_armed_again_by_itself(armed: Rig) -> None:
    move(armed)
    armed.virtual["main"].faults.brown_out(9)
    until(armed, latched(armed, "SERVO_REBOOTED"), PROBE + HEALTH + 2)
    assert armed.loop.condition.state is RobotState.FAULT
    assert not armed.loop.hardware.connected  # everybody on its bus is asked who they are
    armed.seconds(3.0)
    assert armed.loop.hardware.connected
    assert not on(armed)[
        8
    ]  # it was silent for so long that the others were lowered (STATE_STALE), and let go
    armed.call(link.Disarm, ticks=900)
    armed.call(link.Reset)
    armed.seconds(0.5)
    armed.lease()
    assert armed.call(link.Arm).error is None
    assert on(armed).all()


def test_servo_rebooted_a_restart_while_disarmed_is_reported_and_the_bus_identified_again(live: Rig) -> None:
    live.connect()
    live.seconds(1.0)
    live.virtual["main"].faults.brown_out(9)
    until(live, lambda: bool(live.events("SERVO_REBOOTED")), PROBE + HEALTH + 2)
    assert not live.loop.condition.latches
    assert not live.loop.hardware.connected
    until(live, lambda: live.loop.condition.state is RobotState.CONNECTED, 300)


def test_servo_rebooted_a_second_restart_within_a_second_is_identified_anew_too(live: Rig) -> None:
    live.connect()
    live.seconds(1.0)
    for _ in range(2):
        live.virtual["main"].servos.readings.origin[8] = live.clock.now()  # its clock begins anew
        until(live, lambda: not live.loop.hardware.connected, HEALTH + 5)
        until(live, lambda: live.loop.hardware.connected, 60)
    assert len(live.events("SERVO_REBOOTED")) == 1


def test_servo_rebooted_only_the_bus_of_the_restarted_servo_is_asked_anew(make_rig: MakeRig) -> None:
    rig = make_rig("h24-split")
    rig.connect()
    rig.seconds(1.0)
    one, other = rig.loop.hardware.ports
    rig.virtual[one.name].servos.readings.origin[0] = rig.clock.now()
    until(rig, lambda: one.link is PortState.IDENTIFYING, HEALTH + 5)
    assert other.link is PortState.CONNECTED


def test_servo_rebooted_clocks_that_wrap_are_no_restart(live: Rig) -> None:
    """e-manual, Realtime Tick (120): 0..32767 ms, then 0. The servos were powered on 31 s ago."""
    live.virtual["main"].servos.readings.origin[:] -= 31.0
    live.arm()
    assert (live.loop.hardware.slow.tick > 31_000).all()
    live.seconds(2.5)
    assert (live.loop.hardware.slow.tick < 2_000).all()
    assert live.events("SERVO_REBOOTED") == []
    assert live.loop.condition.state is RobotState.ARMED


# ----------------------------------------------------------------------------------------------- SENSE_JUMP


def shift(rig: Rig, id: int, ticks: float) -> None:
    bus = rig.virtual["main"]
    rig.advance_servos()
    bus.servos.muscles.position[bus.faults.rows(id)] += ticks
    bus.servos.invalidate_cache()


def test_sense_jump_a_lost_turn_of_an_armed_joint_holds_and_the_twin_does_not_see_its_beginning(
    armed: Rig,
) -> None:
    move(armed)
    place = armed.loop.robot.joints.buses[0].ids.index(9)
    joint = int(armed.loop.robot.joints.buses[0].joints[place])
    before = armed.loop.robot.measured.position[joint]
    shift(armed, 9, 4096)
    armed.ticks(2)
    assert armed.loop.robot.measured.position[joint] == before
    assert not armed.loop.robot.measured.heard[joint]
    assert armed.loop.robot.measured.age[joint] > 0.009
    until(armed, lambda: bool(armed.events("SENSE_JUMP")), 2)
    until(armed, lambda: armed.loop.executor.motion is Motion.HOLDING, 3)


def test_sense_jump_a_hand_may_throw_a_limp_joint(live: Rig) -> None:
    live.connect()
    shift(live, 9, 700)
    live.ticks(2)
    assert live.loop.robot.measured.heard.all()
    assert live.loop.condition.state is RobotState.CONNECTED
    assert live.events("SENSE_JUMP")


# ----------------------------------------------------------------------------------------------- TX_BACKLOG


def test_tx_backlog_a_stuck_adapter_is_a_fault_and_what_waited_never_leaves(armed: Rig) -> None:
    move(armed)
    bus = armed.virtual["main"]
    bus.faults.stall()
    goals = np.asarray(bus.servos["goal_position"]).copy()
    until(armed, latched(armed, "TX_BACKLOG"), 8)
    armed.seconds(0.3)
    bus.faults.stall(False)
    armed.ticks(1)
    moved = np.abs(np.asarray(bus.servos["goal_position"]).astype(int) - goals.astype(int))
    assert moved.max() < 120  # at most the one packet that waited, not a burst of old goals
    assert on(armed).all()
