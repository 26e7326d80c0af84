"""Reason codes of the running daemon: rules of every tick, devices, ports, arming and motion tolerances."""

from collections.abc import Mapping

from twind.ctl.reasons.reason_text import ReasonText
from twind.robot.finding import ReasonCode

AGAIN = "`twindctl disarm`, `reset`, `arm`"
BUG = "report it with the file of `twindctl dump`"

RUNTIME_CODES: Mapping[ReasonCode, ReasonText] = {
    ReasonCode.ESTOP: ReasonText(
        "latch",
        "A client or the stop button requested an e-stop. The message is its reason.",
        "find the cause, then `twindctl reset`",
    ),
    ReasonCode.LOOP_LATE: ReasonText(
        "warning; HOLD",
        "A tick began late or was missed; several in a row: HOLD.",
        "`twindctl doctor`; reduce the load of this machine",
    ),
    ReasonCode.LEASE_LOST: ReasonText(
        "HOLD",
        "The lease expired or was taken during a motion, or the front process ended.",
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
        "Devices did not answer, or bytes were dropped. From HOLD on, arming is refused.",
        "check wiring, termination, power and baud rate; if virtual, end other programs",
    ),
    ReasonCode.RX_SHAPE: ReasonText(
        "warning",
        "Bytes that are no expected reply were dropped. Once at a start or under load: a late reply.",
        "if it repeats, check wiring; look for a second master or two devices with one id",
    ),
    ReasonCode.FOREIGN_TRAFFIC: ReasonText(
        "armed, arming: fault, INHIBIT; else warning, arming refused",
        "The bus carries unrequested packets: a second master, or two servos with one id (`twindctl "
        "scan --port PORT`).",
        "disconnect the other master; then `twindctl disarm`, `twindctl reset`",
    ),
    ReasonCode.SERVO_ALERT: ReasonText(
        "armed, arming: fault, HOLD; else warning, arming refused",
        "A servo reports a hardware error, or reported one last and cannot show without torque whether it is "
        "gone (RobStride). It may have no torque. A free-standing robot settles or is damped.",
        "find the cause (`twindctl status --joints`), `twindctl disarm`, `twindctl reboot BUS ID`",
    ),
    ReasonCode.TORQUE_MISMATCH: ReasonText(
        "fault, HOLD",
        "Torque reads back off or unknown while armed (two readings), or torque off was not confirmed.",
        f"look up its hardware error (`twindctl status --joints`); {AGAIN}",
    ),
    ReasonCode.SERVO_REBOOTED: ReasonText(
        "fault, as TORQUE_MISMATCH",
        "A servo restarted: it has no torque and may have lost settings and turn.",
        f"check its power and cable; {AGAIN}",
    ),
    ReasonCode.WATCHDOG_TRIPPED: ReasonText(
        "fault, HOLD",
        "A servo's watchdog tripped, or a servo without one was silent for 0.1 s.",
        f"check the cable, or find out what stopped the loop; {AGAIN}",
    ),
    ReasonCode.SENSE_JUMP: ReasonText(
        "reading dropped; armed, several: HOLD",
        "A position is farther from the last one than the motor can turn.",
        "check horn, gear and cable; calibrate again",
    ),
    ReasonCode.OUT_OF_LIMIT: ReasonText(
        "fault, HOLD; arming refused",
        "A measured position, or a withheld goal, is beyond the hard limit. It may only move inwards.",
        "`twindctl disarm`, move the joint inside by hand, check its calibration",
    ),
    ReasonCode.FOLLOW_ERR: ReasonText(
        "fault, HOLD at the measured position; farther: DAMP",
        "A joint lags its goal too far for too long.",
        f"check what blocks it, load and gains; {AGAIN}",
    ),
    ReasonCode.SENSE_FROZEN: ReasonText(
        "fault, HOLD",
        "A position does not change although its goal moves and the motor runs. (At an obstacle: "
        "FOLLOW_ERR.)",
        f"check its encoder and cable; {AGAIN}",
    ),
    ReasonCode.OVERSPEED: ReasonText(
        "HOLD", "A joint turns faster than permitted under torque.", "check load and gains"
    ),
    ReasonCode.OVERCURRENT: ReasonText(
        "warning; fault, HOLD at the measured position; DAMP",
        "The load is near the current limit for too long. Or I²t above `heat.continuous` is too high: "
        "warning, HOLD, SETTLE.",
        f"remove the obstacle or load; let it rest; {AGAIN}",
    ),
    ReasonCode.OVERTEMP: ReasonText(
        "warning; half speed; fault, SETTLE",
        "Three of five readings reach a bound of `types.TYPE.heat`. Arming is refused until it cools.",
        "let it cool; reduce the load; then `twindctl reset`",
    ),
    ReasonCode.VOLTAGE: ReasonText(
        "warning; fault, SETTLE; DAMP",
        "The lowest supply passes a bound of `types.TYPE.supply`. Too high, or not read: warning.",
        "check battery, supply and cables; then `twindctl reset`",
    ),
    ReasonCode.LEAD_LIMIT: ReasonText(
        "slower; waits; HOLD",
        "A joint whose device has no watchdog stays behind its goal: the motion waits for it.",
        "check what blocks it, load and gains; a gripper: grip with a goal near the object",
    ),
    ReasonCode.LOOKAHEAD_COLLISION: ReasonText(
        "slower; HOLD",
        "The motion comes closer than `warn_m` (slower) or `block_m` (HOLD) to robot or world.",
        "choose another path: the message names the pair",
    ),
    ReasonCode.FALLING: ReasonText(
        "fault; HOLD, DAMP or SETTLE by `fall.reaction`; arming refused",
        "The robot falls or has fallen. Arming is refused until it stands and its IMU is read.",
        f"set it on its feet; {AGAIN}",
    ),
    ReasonCode.CONTACT: ReasonText(
        "warning",
        "A hand, a load or an obstacle turns a joint: [torque](contact.md) that an identified model lacks.",
        "none; if nothing touches the robot, identify it again",
    ),
    ReasonCode.CONTACT_HOLD: ReasonText(
        "HOLD",
        "Torque from outside exceeds `gate.contact.hold_nm` of the joint; new motions wait until it is gone.",
        "release the joint; if nothing touches the robot, raise the bound or identify again",
    ),
    ReasonCode.DETECTION_LOST: ReasonText(
        "warning",
        "Contacts (`gate.contact`) or falls (`fall`) are not detected: a joint or the IMU gives no reading.",
        "stop the motion; check the device that the message or STATE_STALE names",
    ),
    ReasonCode.STEP_LIMIT: ReasonText(
        "goal withheld, HOLD",
        "A goal is farther from the last one sent than the velocity limit allows in one tick.",
        "after TX_BACKLOG: its remedy; else a defect of twind: report it",
    ),
    ReasonCode.WIRE_CLAMP: ReasonText(
        "nothing sent, fault", "An encoded goal is outside the calibrated range.", BUG
    ),
    ReasonCode.TX_BACKLOG: ReasonText(
        "warning; armed, several: fault, HOLD",
        "The port still held old bytes. It was emptied and the next packet not sent.",
        f"replug or replace the adapter; {AGAIN}",
    ),
    ReasonCode.CAN_BUS_STATE: ReasonText(
        "warning; armed, arming: fault; arming refused",
        "The CAN controller is error passive (warning), off the bus or not acknowledged, or all "
        "actuators are silent. The bus counts as lost.",
        f"power, termination (60 Ω), bit rate, wiring; {AGAIN}",
    ),
    ReasonCode.MIRROR_DRIFT: ReasonText(
        "warning",
        "Robot and simulation differ for too long. The message names bodies whose simulated contact "
        "blocks the joint.",
        "correct these shapes or exclude the pair; else calibration, load, gains",
    ),
    ReasonCode.INTERNAL: ReasonText(
        "latch, goal held; repeated: INHIBIT, end",
        "An exception in a tick, or a goal in a state that permits none.",
        BUG,
    ),
    ReasonCode.TIME_GAP: ReasonText(
        "fault, HOLD",
        "Armed or arming, a tick began later than the servo watchdogs wait, or the machine slept. "
        "Torque stays on.",
        f"find out what stopped the machine; {AGAIN}",
    ),
    ReasonCode.SUPPLY_RELAY: ReasonText(
        "motion and arming refused",
        "The supply relay opened for want of a tick or cannot be used, or the measured supply does not "
        "follow it.",
        "as the message says; [supply relay](safety.md#supply-relay)",
    ),
    ReasonCode.SOCKETS_GONE: ReasonText(
        "warning; HOLD, motion and arming refused; `Check` warns",
        "A socket's file was removed or replaced and the daemon cannot bind it again.",
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
        "Another model, or an unusable register, such as operating mode, torque at boot, or homing "
        "offset. RAM restored at boot, long return delay: warning.",
        "`twindctl doctor --fix`, or `twindctl adopt JOINT`; else correct the robot file",
    ),
    ReasonCode.ARM_FAILED: ReasonText(
        "torque off again",
        "A state other than `connected`, torque on in some joints only, a joint that moves or jumps, "
        "or a servo that does not obey.",
        "as the message says, then `twindctl arm`",
    ),
    ReasonCode.STOP_NOT_FOUND: ReasonText(
        "torque off, settings restored",
        "Homing failed or was not permitted: no stop where described, an obstacle, captures that "
        "differ, a wrong direction.",
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
        "A joint did not reach its goal tolerance in time.",
        "slower motion, wider tolerance, or remove the obstacle",
    ),
}
