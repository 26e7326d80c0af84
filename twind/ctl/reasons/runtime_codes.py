"""Reason codes of the running daemon: rules of every tick, devices, ports, arming and motion tolerances."""

from collections.abc import Mapping

from twind.ctl.reasons.reason_text import ReasonText
from twind.robot.finding import ReasonCode

AGAIN = "`twindctl disarm`, `twindctl reset`, `twindctl arm`"
BUG = "report this defect with the file of `twindctl dump` and the log"

RUNTIME_CODES: Mapping[ReasonCode, ReasonText] = {
    ReasonCode.ESTOP: ReasonText(
        "latch",
        "A client requested an e-stop. The message is its reason.",
        "find out why the robot was stopped, then `twindctl reset`",
    ),
    ReasonCode.LOOP_LATE: ReasonText(
        "warning; HOLD",
        "A tick began late or ticks were missed; several in a row cause HOLD.",
        "`twindctl doctor`; reduce the load of this machine",
    ),
    ReasonCode.LEASE_LOST: ReasonText(
        "HOLD",
        "The lease expired during a motion, another client took it, or the front process ended.",
        "renew the lease, or follow the motion with `more`",
    ),
    ReasonCode.STREAM_STALE: ReasonText(
        "HOLD", "No new setpoint arrived in time.", "send setpoints more often"
    ),
    ReasonCode.STATE_STALE: ReasonText(
        "warning; HOLD; fault",
        "A joint sends no readings. After a fault the others hold; a free-standing robot settles.",
        "check the joint's cable, power and id",
    ),
    ReasonCode.BUS_ERRORS: ReasonText(
        "warning; HOLD; fault",
        "In exchanges of one bus a device did not answer or bytes were dropped. From HOLD on, arming is "
        "refused. A parked device does not count.",
        "wiring, termination, power, baud rate of the bus; if virtual: load of this machine",
    ),
    ReasonCode.RX_SHAPE: ReasonText(
        "warning",
        "Bytes that are no expected reply were dropped.",
        "check wiring; look for a second master or two devices with one id",
    ),
    ReasonCode.FOREIGN_TRAFFIC: ReasonText(
        "armed, arming: fault, INHIBIT; else warning, arming refused",
        "The bus carries valid packets that the daemon did not request. `twindctl scan --port PORT` finds "
        "two servos with one id.",
        "disconnect the other master; then `twindctl disarm`, `twindctl reset`",
    ),
    ReasonCode.SERVO_ALERT: ReasonText(
        "armed, arming: fault, HOLD; else warning, arming refused",
        "A servo reports a hardware error; one that shut down has no torque. A free-standing robot "
        "settles, and is damped once a leg reads back without torque.",
        "find the cause (`twindctl status --joints`), `twindctl disarm`, `twindctl reboot BUS ID`",
    ),
    ReasonCode.TORQUE_MISMATCH: ReasonText(
        "fault, HOLD",
        "Torque reads back off or unknown while armed; a free-standing robot settles, and is damped where "
        "a leg has no torque. Also: torque off was not confirmed. `twindctl status --joints` shows errors.",
        f"look up its hardware error; {AGAIN}",
    ),
    ReasonCode.SERVO_REBOOTED: ReasonText(
        "fault, as TORQUE_MISMATCH",
        "A servo restarted by itself: its clock jumped, or its armed watchdog reads 0. It has no torque "
        "and may have lost settings and turn. Its bus is identified again before arming.",
        f"check its power and cable; {AGAIN}",
    ),
    ReasonCode.WATCHDOG_TRIPPED: ReasonText(
        "fault, HOLD", "A servo's watchdog tripped.", f"find out what stopped the loop; {AGAIN}"
    ),
    ReasonCode.SENSE_JUMP: ReasonText(
        "reading dropped; HOLD",
        "A position is farther from the last one than the motor can turn. Several in a row, armed: HOLD. "
        "A new position is used when readings agree again. With torque off: warning only.",
        "check horn, gear and cable; calibrate again",
    ),
    ReasonCode.OUT_OF_LIMIT: ReasonText(
        "fault, HOLD; arming refused",
        "A measured position is beyond the hard limit. From there a motion may only lead inwards.",
        "`twindctl disarm`, move the joint inside by hand, check its calibration",
    ),
    ReasonCode.FOLLOW_ERR: ReasonText(
        "fault, HOLD at the measured position; farther: DAMP",
        "A joint lags its goal by more than the bound, for longer than permitted. Not judged: silent "
        "joints, joints without torque or with a tripped watchdog.",
        f"check what blocks it, load and gains; {AGAIN}",
    ),
    ReasonCode.SENSE_FROZEN: ReasonText(
        "fault, HOLD",
        "A position does not change although its goal moves and the motor runs. A motor that pushes "
        "against an obstacle reports FOLLOW_ERR. So does a stuck encoder under high load.",
        f"check its encoder and cable; {AGAIN}",
    ),
    ReasonCode.OVERSPEED: ReasonText(
        "HOLD", "A joint turns faster than permitted while the daemon holds torque.", "check load and gains"
    ),
    ReasonCode.OVERCURRENT: ReasonText(
        "warning; fault, HOLD at the measured position; DAMP",
        "The load is near the current limit (`current_limit_a`, else the servo's own) for too long. Or I²t: "
        "load above `heat.continuous`, squared and summed: warning, HOLD, SETTLE; arming waits until it "
        "has recovered. Unknown load and silent joints are not judged.",
        f"remove the obstacle or load; let it rest; {AGAIN}",
    ),
    ReasonCode.OVERTEMP: ReasonText(
        "warning; half speed; fault, SETTLE",
        "Three of five readings reach a bound of `types.TYPE.heat`; arming is refused until it cools. A "
        "fast rise, or one reading that the others do not confirm, only warns.",
        "let it cool; reduce the load; then `twindctl reset`",
    ),
    ReasonCode.VOLTAGE: ReasonText(
        "warning; fault, SETTLE; DAMP",
        "The lowest supply, confirmed by two readings, passes a bound of `types.TYPE.supply`. Too high, or "
        "not read: warning.",
        "check battery, supply and cables; then `twindctl reset`",
    ),
    ReasonCode.LOOKAHEAD_COLLISION: ReasonText(
        "slower; HOLD",
        "The next part of the motion comes closer than `warn_m` to the robot or the world: slower, down to "
        "a tenth; closer than `block_m`: HOLD. Holds, stops, the way to the rest pose and ways out of a "
        "bad pose are not judged.",
        "choose another path: the message names the pair",
    ),
    ReasonCode.STEP_LIMIT: ReasonText(
        "goal withheld, HOLD",
        "A goal is farther from the last than the velocity limit allows in one tick. After TX_BACKLOG: the "
        "previous goal was not sent.",
        "after TX_BACKLOG: its remedy; else a defect of twind: report it",
    ),
    ReasonCode.WIRE_CLAMP: ReasonText(
        "nothing sent, fault", "An encoded goal is outside the calibrated range.", BUG
    ),
    ReasonCode.TX_BACKLOG: ReasonText(
        "warning; armed, several: fault, HOLD",
        "The port still held more than the last packet. It was emptied and the next packet not sent.",
        f"replug or replace the adapter; {AGAIN}",
    ),
    ReasonCode.CAN_BUS_STATE: ReasonText(
        "warning; armed, arming: fault; arming refused",
        "The CAN controller is error passive (warning), off the bus or without acknowledgement; or all "
        "actuators are silent. The bus is closed and counts as lost (PORT_LOST); it opens and "
        "identifies again, and nothing moves by itself. Termination: 60 Ω between the wires.",
        f"power, termination, bit rate, wiring; {AGAIN}",
    ),
    ReasonCode.MIRROR_DRIFT: ReasonText(
        "warning",
        "Robot and simulation of the same goals differ for too long. The message names two bodies whose "
        "simulated contact blocks the joint.",
        "correct these shapes or exclude the pair; else calibration, load, gains",
    ),
    ReasonCode.INTERNAL: ReasonText(
        "latch, goal held; repeated: INHIBIT, end",
        "An exception in a tick, or a goal in a state that permits none.",
        BUG,
    ),
    ReasonCode.TIME_GAP: ReasonText(
        "fault, HOLD",
        "Armed or arming, a tick began later than the servo watchdogs wait, or the machine slept. No old "
        "goal is sent. Torque stays on; servos may have stopped by themselves.",
        f"find out what stopped the machine; {AGAIN}",
    ),
    ReasonCode.SOCKETS_GONE: ReasonText(
        "warning; HOLD, motion and arming refused; `Check` warns",
        "The file of a socket was removed or replaced. The daemon binds it again and motion goes on. Where "
        "that fails, motion and arming stay refused in every mode until clients can connect.",
        "as the message says; `twindctl estop` still lowers the robot",
    ),
    ReasonCode.PORT_LOST: ReasonText(
        "bus lost; armed: latch", "A port disappeared.", "plug it in; `twindctl disarm`, `twindctl reset`"
    ),
    ReasonCode.PORT_UNAVAILABLE: ReasonText(
        "warning", "A port cannot be opened; the daemon tries again.", "as the message says"
    ),
    ReasonCode.DEVICE_MISSING: ReasonText(
        "bus not identified",
        "No device answers with this id.",
        "its power, cable, id and baud rate; `twindctl scan`",
    ),
    ReasonCode.DEVICE_MISMATCH: ReasonText(
        "arming refused; some: warning",
        "Another model, or an unusable register: operating mode, torque at boot, torque by goal, profile in "
        "time, homing offset beyond ±1024 in position mode. Warning only: RAM restored at boot, a long "
        "return delay (unless one reading exceeds a tick; then the bus is not read), a mode without "
        "position limits.",
        "`twindctl doctor --fix`, or `twindctl adopt JOINT`; else correct the robot file",
    ),
    ReasonCode.ARM_FAILED: ReasonText(
        "torque off again",
        "Arming in another state than `connected`; torque found on in some joints only; a joint that moves "
        "or jumps; a servo that does not obey.",
        "as the message says, then `twindctl arm`",
    ),
    ReasonCode.STOP_NOT_FOUND: ReasonText(
        "torque off, settings restored",
        "Homing failed: no stop where described, an obstacle, captures that differ, a wrong "
        "direction; or it was not permitted to begin.",
        "as the message says; calibration/README.md",
    ),
    ReasonCode.TORQUE_INHERITED: ReasonText(
        "warning",
        "Torque was on when the daemon started, or could not be switched off. In `mirror` first "
        "`twindctl mode live`.",
        "`twindctl arm` takes it over, `twindctl disarm` lowers the robot",
    ),
    ReasonCode.PATH_TOLERANCE: ReasonText(
        "motion aborted, HOLD",
        "A joint left its path tolerance.",
        "slower motion, wider tolerance, or remove the obstacle",
    ),
    ReasonCode.GOAL_TOLERANCE: ReasonText(
        "motion fails",
        "A joint did not reach its goal tolerance in time. In `sim` and `mirror` the default is 0.2 rad.",
        "slower motion, wider tolerance, or remove the obstacle or contact",
    ),
}
