"""Situations that lead to each code of what is judged in every tick."""

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from tests.support.contact_rig import ContactRig
from tests.support.daemon_rig import Rig
from tests.support.fall_rig import FallRig
from tests.support.scene_rig import SCENES, Told, faults, leads_to, move, reported_codes
from twind import link
from twind.robot.fall_settings import FallReaction
from twind.robot.finding import ReasonCode
from twind.robot.trajectory import Trajectory
from twind.safety.guard import FINE
from twind_drivers.virtual.servo_physics import FirstOrderPhysics


@leads_to(ReasonCode.LOOP_LATE)
def a_tick_is_late(made: Rig) -> None:
    exchange = made.loop.hardware.exchange
    slow = iter([0.025])

    def hindered(goal: Any, now: float) -> Any:
        made.clock.time += next(slow, 0.0)
        return exchange(goal, now)

    made.loop.hardware.exchange = hindered  # type: ignore[method-assign]
    made.loop.run(until=made.clock.now() + 0.3)
    made.ticks(2)


@leads_to(ReasonCode.LEASE_LOST)
def the_client_forgets_its_lease(made: Rig) -> None:
    made.submit(made.path("head_yaw", [1.0], [4.0]))
    made.seconds(1.5)


@leads_to(ReasonCode.STREAM_STALE)
def a_stream_falls_silent(made: Rig) -> None:
    made.call(link.Setpoint, joints=[0], positions=[0.01])
    made.seconds(0.3)


@leads_to(ReasonCode.STATE_STALE)
def a_servo_falls_silent(made: Rig) -> None:
    faults(made).silence(7)
    made.seconds(0.7)


@leads_to(ReasonCode.BUS_ERRORS)
def the_wire_is_noisy(made: Rig) -> None:
    faults(made).bit_errors(0.1, to_servos=False)
    made.seconds(0.3)


@leads_to(ReasonCode.RX_SHAPE)
def a_reply_comes_without_a_sender(made: Rig) -> None:
    faults(made).corrupt(1)
    made.seconds(0.1)


@leads_to(ReasonCode.FOREIGN_TRAFFIC)
def a_stranger_talks(made: Rig) -> None:
    faults(made).foreign(3)
    made.ticks(8)


@leads_to(ReasonCode.SERVO_ALERT)
def a_servo_shuts_down(made: Rig) -> None:
    faults(made).damage(9, 0b100000)
    made.ticks(5)


@leads_to(ReasonCode.TORQUE_MISMATCH)
def a_servo_drops_its_torque(made: Rig) -> None:
    made.virtual["main"].servos.torque(3, False)
    made.seconds(0.3)


@leads_to(ReasonCode.SERVO_REBOOTED)
def a_servo_browns_out(made: Rig) -> None:
    faults(made).brown_out(9)
    made.seconds(1.5)


@leads_to(ReasonCode.WATCHDOG_TRIPPED)
def the_daemon_is_away_for_a_quarter_second(made: Rig) -> None:
    made.clock.time += 0.25
    made.seconds(0.5)


@leads_to(ReasonCode.TIME_GAP)
def the_daemon_is_away_for_longer_than_a_watchdog(made: Rig) -> None:
    made.clock.time += 0.25
    made.ticks(2)


@leads_to(ReasonCode.SENSE_JUMP)
def a_joint_loses_a_turn(made: Rig) -> None:
    bus = made.virtual["main"]
    made.advance_servos()
    bus.servos.muscles.position[8] += 4096
    bus.servos.invalidate_cache()
    made.ticks(6)


@leads_to(ReasonCode.OUT_OF_LIMIT, arm=False, start={"l_knee": 2.4})
def a_knee_bent_too_far_shall_be_armed(made: Rig) -> None:
    made.connect()
    made.lease()
    made.call(link.Arm)


@leads_to(ReasonCode.FOLLOW_ERR)
def something_holds_a_shaft(made: Rig) -> None:
    faults(made).lock(1)
    move(made, seconds=1.5)
    made.seconds(1.5)


@leads_to(ReasonCode.SENSE_FROZEN)
def an_encoder_repeats_itself(made: Rig) -> None:
    faults(made).freeze(1)
    move(made, seconds=2.0)
    made.seconds(1.0)


class Driven(FirstOrderPhysics):
    """Muscles that something turns faster than their motor could."""

    driven = False

    def advance(self, now: float) -> None:
        turned = 3500.0 * max(now - self._time, 0.0)  # ticks: 5.4 rad/s
        super().advance(now)
        if self.driven:
            self.position[0] += turned
            self.velocity[0] = 224.0  # of 0.229 rpm: 5.4 rad/s


@leads_to(ReasonCode.OVERSPEED, muscles=Driven)
def something_turns_a_joint(made: Rig) -> None:
    made.virtual["main"].servos.muscles.driven = True
    made.ticks(6)


@leads_to(ReasonCode.OVERCURRENT)
def a_motor_pushes_against_a_wall(made: Rig) -> None:
    faults(made).lock(1)
    made.submit(made.path("head_yaw", [0.15], [1.0]))
    made.seconds(3.0)


@leads_to(ReasonCode.OVERTEMP)
def a_motor_gets_hot(made: Rig) -> None:
    faults(made).heat(5, 66.0)
    made.seconds(2.0)


@leads_to(ReasonCode.VOLTAGE)
def the_battery_runs_down(made: Rig) -> None:
    faults(made).supply(10.9)
    made.seconds(1.0)


@leads_to(ReasonCode.LOOKAHEAD_COLLISION)
def the_legs_cross_without_an_earlier_check(made: Rig) -> None:
    rows = np.tile(made.loop.robot.measured.position, (1, 1))
    places = [made.names.index(name) for name in ("l_hip_roll", "r_hip_roll")]
    rows[0, places] = (-0.4, 0.4)
    commanded = np.zeros(24, np.bool_)
    commanded[places] = True
    made.submit(Trajectory(np.array([2.0]), rows, commanded), more=True)
    made.seconds(2.5)


@leads_to(ReasonCode.STEP_LIMIT)
def a_goal_leaps(made: Rig) -> None:
    wild = made.loop.executor.reference.position.copy()
    wild[0] = 1.0
    made.loop.executor.begin(wild)
    made.ticks(3)


@leads_to(ReasonCode.WIRE_CLAMP)
def a_goal_out_of_range_gets_past_every_rule(made: Rig) -> None:
    wild = made.loop.executor.reference.position.copy()
    wild[made.names.index("l_knee")] = 2.3
    made.loop.executor.begin(wild)
    made.loop.parts.guard.judge = lambda facts: FINE  # type: ignore[method-assign]
    made.ticks(3)


@leads_to(ReasonCode.TX_BACKLOG)
def the_adapter_is_stuck(made: Rig) -> None:
    faults(made).stall()
    made.ticks(10)


@leads_to(ReasonCode.CAN_BUS_STATE, robot="h24-mixed")
def all_servos_of_a_leg_lose_power(made: Rig) -> None:
    made.virtual["l_leg"].faults.power(False)
    made.ticks(13)


@leads_to(ReasonCode.LEAD_LIMIT, robot="so101")
def a_servo_without_a_watchdog_is_blocked(made: Rig) -> None:
    faults(made).lock(5)
    move(made, "wrist_roll", to=1.0, seconds=2.0)
    made.seconds(1.0)


@leads_to(ReasonCode.MIRROR_DRIFT)
def a_joint_gives_way_where_its_model_does_not(made: Rig) -> None:
    faults(made).lock(1)
    move(made, to=0.12, seconds=1.0)
    made.seconds(2.0)


@leads_to(ReasonCode.INTERNAL)
def a_tick_breaks(made: Rig) -> None:
    judge = made.loop.parts.guard.judge
    made.loop.parts.guard.judge = None  # type: ignore[assignment, method-assign]
    made.ticks(1)
    made.loop.parts.guard.judge = judge  # type: ignore[method-assign]
    made.ticks(1)


def a_robot_is_pushed_over(_: Path) -> Told:
    with closing(FallRig(FallReaction.HOLD)) as made:
        made.stand()
        made.push(4.0, 0.0, 0.3)
        return reported_codes(made)


SCENES[ReasonCode.FALLING] = a_robot_is_pushed_over


def a_hand_holds_the_elbow(_: Path) -> Told:
    rig = ContactRig()
    try:
        rig.arm()
        rig.press("r_elbow", 1.5)
        rig.seconds(0.3)
        return reported_codes(rig)
    finally:
        rig.close()


def the_imu_of_a_standing_robot_falls_silent(_: Path) -> Told:
    with closing(FallRig(FallReaction.HOLD)) as made:
        made.stand()
        faults(made).drop(1000, 200)
        made.seconds(0.5)
        return reported_codes(made)


SCENES[ReasonCode.DETECTION_LOST] = the_imu_of_a_standing_robot_falls_silent
SCENES[ReasonCode.CONTACT] = a_hand_holds_the_elbow
SCENES[ReasonCode.CONTACT_HOLD] = a_hand_holds_the_elbow
