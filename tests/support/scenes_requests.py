"""Situations that lead to each code of what is asked of the loop, of ports, devices and arming."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from tests.support.daemon_rig import CLIENT, Rig
from tests.support.described_robot import redescribe
from tests.support.power_stand_in import PowerStandIn
from tests.support.scene_rig import ask, faults, leads_to, move
from twind import link
from twind.config.config_files import live_denied
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode
from twind_drivers.bus import PortError


@leads_to(ReasonCode.LEASE_MISSING)
def another_client_moves_it(made: Rig) -> None:
    ask(made, client=CLIENT + 1)


@leads_to(ReasonCode.VALID_TOO_LONG)
def a_setpoint_shall_be_followed_for_a_second(made: Rig) -> None:
    made.call(link.Setpoint, joints=[0], positions=[0.01], valid_for=1.0)


@leads_to(ReasonCode.STREAM_STOPPED)
def a_stream_goes_on_after_another_client_stopped_it(made: Rig) -> None:
    setpoint = {"joints": [0], "positions": [0.01], "valid_for": 0.1}
    made.call(link.Setpoint, **setpoint)
    made.call(link.Cancel, client=CLIENT + 1)
    made.call(link.Setpoint, **setpoint)


@leads_to(ReasonCode.ESTOP)
def another_client_stops_it(made: Rig) -> None:
    made.call(link.EStop, level="cut", reason="test")


@leads_to(ReasonCode.ESTOP_LATCHED)
def it_shall_move_after_an_estop(made: Rig) -> None:
    made.call(link.EStop, level="cut", reason="test")
    made.lease()
    ask(made)


@leads_to(ReasonCode.FAULT_LATCHED)
def it_shall_move_after_a_fault(made: Rig) -> None:
    made.virtual["main"].servos.torque(3, False)
    made.seconds(0.3)
    made.lease()
    ask(made)


@leads_to(ReasonCode.SOCKETS_GONE)
def it_shall_move_without_a_socket_for_a_stop(made: Rig) -> None:
    made.front.outer.send(link.encode(link.Reachable(missing="control.sock: removed")))
    made.lease()
    ask(made)


@leads_to(ReasonCode.SUPPLY_RELAY, arm=False, power=PowerStandIn())
def the_supply_stays_behind_the_open_relay(made: Rig) -> None:
    made.connect()
    made.seconds(2.0)


@leads_to(ReasonCode.MODE_DENIES, arm=False, mode=Mode.MIRROR)
def a_mirror_shall_be_armed(made: Rig) -> None:
    made.connect()
    made.lease()
    made.call(link.Arm)


UNFINISHED = live_denied("h24", {"main": "/dev/x"}, Path("none"), calibrated=True, open_items=["support"])


@leads_to(ReasonCode.ROBOT_UNFINISHED, arm=False, mode=Mode.MIRROR, live_denied=UNFINISHED)
def a_robot_with_open_items_shall_go_live(made: Rig) -> None:
    made.connect()
    made.lease()
    made.call(link.SetMode, mode="live")


@leads_to(ReasonCode.NOT_ARMED, arm=False)
def it_shall_move_without_torque(made: Rig) -> None:
    made.connect()
    made.lease()
    ask(made)


@leads_to(ReasonCode.JOINT_LIMP, arm=False)
def a_joint_that_stays_limp_shall_move(made: Rig) -> None:
    made.connect()
    made.lease()
    made.call(link.Arm, joints=list(range(1, len(made.names))))
    made.submit(made.path(made.names[0], [0.1], [1.0]))
    made.ticks(5)


@leads_to(ReasonCode.CALIB_MISSING, arm=False)
def a_joint_without_a_zero_shall_be_armed(made: Rig) -> None:
    made.connect()
    known = (False, *made.loop.robot.joints.calibrated[1:])
    redescribe(made.loop, joints=replace(made.loop.robot.joints, calibrated=known))
    made.lease()
    made.call(link.Arm)


@leads_to(ReasonCode.CALIB_MISMATCH, arm=False)
def a_servo_was_given_another_offset(made: Rig) -> None:
    memory = made.virtual["main"].servos.memory
    memory.store(4, memory.tables[4]["homing_offset"], 77)
    made.connect()
    made.lease()
    made.call(link.Arm)


@leads_to(ReasonCode.HW_DISCONNECTED, arm=False)
def a_silent_servo_shall_be_armed(made: Rig) -> None:
    made.connect()
    faults(made).silence(7)
    made.seconds(0.3)
    made.lease()
    made.call(link.Arm)


@leads_to(ReasonCode.LATENCY_WARN, arm=False)
def the_adapter_waits_60_ms(made: Rig) -> None:
    late(made, 0.06)


@leads_to(ReasonCode.LATENCY_BLOCK, arm=False)
def the_loop_is_120_ms_behind(made: Rig) -> None:
    late(made, 0.12)
    made.lease()
    made.call(link.Arm)


def late(made: Rig, seconds: float) -> None:
    """Every exchange takes that much longer, as far as the clock can tell."""
    made.connect()
    exchange = made.loop.hardware.exchange

    def slow(goal: Any, now: float) -> Any:
        state = exchange(goal, now)
        return replace(state, round_trip=seconds)

    made.loop.hardware.exchange = slow  # type: ignore[method-assign]
    made.seconds(0.6)


@leads_to(ReasonCode.THERMAL_HEADROOM, arm=False)
def a_hot_servo_shall_be_armed(made: Rig) -> None:
    made.connect()
    faults(made).heat(5, 68.0)
    made.seconds(0.5)
    made.lease()
    made.call(link.Arm)


@leads_to(ReasonCode.VOLTAGE_LOW, arm=False)
def an_empty_battery_shall_arm(made: Rig) -> None:
    made.connect()
    faults(made).supply(10.3)
    made.seconds(0.5)
    made.lease()
    made.call(link.Arm)


@leads_to(ReasonCode.BUSY)
def two_motions_shall_wait(made: Rig) -> None:
    for _ in range(2):
        made.submit(made.path("head_yaw", [0.2], [1.0]), start_in=5.0)
    made.ticks(3)


@leads_to(ReasonCode.CONFIG_REFUSED, arm=False)
def a_limit_shall_widen_while_the_daemon_runs(made: Rig) -> None:
    made.adopt({"joints.head_yaw.limits_rad": [-20.0, 20.0]})


# ------------------------------------------------------------------------------- ports, devices, arming


@leads_to(ReasonCode.PORT_LOST)
def the_cable_is_pulled(made: Rig) -> None:
    faults(made).unplug()
    made.ticks(5)


@leads_to(ReasonCode.PORT_UNAVAILABLE, arm=False)
def the_port_cannot_be_opened(made: Rig) -> None:
    def closed(name: str) -> Any:
        raise PortError(f"virtual:{name}", "no such port")

    made.loop.hardware.ports[0].opener = closed
    made.seconds(0.5)


@leads_to(ReasonCode.DEVICE_MISSING, arm=False)
def an_id_never_answers(made: Rig) -> None:
    faults(made).silence(5)
    made.seconds(1.0)
    made.lease()
    made.call(link.Arm)


@leads_to(ReasonCode.DEVICE_MISMATCH, arm=False)
def another_model_sits_on_the_wire(made: Rig) -> None:
    memory = made.virtual["main"].servos.memory
    memory.store(4, memory.tables[4]["model_number"], 1060)
    made.seconds(1.0)
    made.lease()
    made.call(link.Arm)


@leads_to(ReasonCode.ARM_FAILED, arm=False)
def it_was_found_half_energised(made: Rig) -> None:
    made.virtual["main"].servos.torque(0, True)
    made.connect()
    made.lease()
    made.call(link.Arm)


@leads_to(ReasonCode.STOP_NOT_FOUND, arm=False, robot="h24-split")
def the_place_of_a_stop_is_unknown(made: Rig) -> None:
    made.connect()
    made.lease()
    made.call(link.Calibrate, on=True)
    made.call(link.FindStop, joint=0, side="lower")


@leads_to(ReasonCode.TORQUE_INHERITED, arm=False)
def torque_was_found_on(made: Rig) -> None:
    for row in range(24):
        made.virtual["main"].servos.torque(row, True)
    made.connect()
    made.seconds(0.2)


@leads_to(ReasonCode.PATH_TOLERANCE)
def a_joint_leaves_its_path(made: Rig) -> None:
    faults(made).lock(1)
    made.submit(made.path("head_yaw", [1.0], [4.0]), more=True, tolerances=[(0, 0.02, None)])
    made.seconds(1.0)


@leads_to(ReasonCode.GOAL_TOLERANCE)
def a_joint_does_not_arrive(made: Rig) -> None:
    faults(made).lock(1)
    move(made, to=0.1, seconds=1.0, tolerances=[(0, None, 0.01)], goal_time=0.2)
    made.seconds(2.0)
