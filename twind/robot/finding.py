"""Findings: causes of refusals, warnings and changes, as values, never exceptions."""

from dataclasses import dataclass, field
from enum import StrEnum


class ReasonCode(StrEnum):
    """Every reason code, those of a submission first. Causes and remedies: docs/reason-codes.md."""

    FRAME_TOO_LARGE = "FRAME_TOO_LARGE"
    FRAME_INCOMPLETE = "FRAME_INCOMPLETE"
    RATE_LIMIT = "RATE_LIMIT"
    BAD_JSON = "BAD_JSON"
    BAD_SCHEMA = "BAD_SCHEMA"
    AUTH_ROLE = "AUTH_ROLE"
    LEASE_MISSING = "LEASE_MISSING"
    ESTOP_LATCHED = "ESTOP_LATCHED"
    FAULT_LATCHED = "FAULT_LATCHED"
    MODE_DENIES = "MODE_DENIES"
    NOT_ARMED = "NOT_ARMED"
    JOINT_LIMP = "JOINT_LIMP"
    ROBOT_UNFINISHED = "ROBOT_UNFINISHED"
    CALIB_MISSING = "CALIB_MISSING"
    CALIB_MISMATCH = "CALIB_MISMATCH"
    HW_DISCONNECTED = "HW_DISCONNECTED"
    LATENCY_WARN = "LATENCY_WARN"
    LATENCY_BLOCK = "LATENCY_BLOCK"
    CMD_EXPIRED = "CMD_EXPIRED"
    TOO_DISTANT = "TOO_DISTANT"
    VALID_TOO_LONG = "VALID_TOO_LONG"
    EMPTY = "EMPTY"
    NO_JOINTS = "NO_JOINTS"
    UNKNOWN_JOINT = "UNKNOWN_JOINT"
    DUP_JOINT = "DUP_JOINT"
    BAD_SHAPE = "BAD_SHAPE"
    TOO_MANY_POINTS = "TOO_MANY_POINTS"
    NONFINITE = "NONFINITE"
    TIME_ORDER = "TIME_ORDER"
    POS_LIMIT = "POS_LIMIT"
    START_JUMP = "START_JUMP"
    VEL_LIMIT = "VEL_LIMIT"
    ACC_LIMIT = "ACC_LIMIT"
    JERK_LIMIT = "JERK_LIMIT"
    BRAKE_DISTANCE = "BRAKE_DISTANCE"
    END_NOT_AT_REST = "END_NOT_AT_REST"
    RETIMED = "RETIMED"  # a change, not a refusal: policy `retime`
    STOP_APPENDED = "STOP_APPENDED"  # a change: `append_stop`
    SELF_COLLISION = "SELF_COLLISION"
    KEEP_OUT = "KEEP_OUT"  # the world's geometry
    FLOOR = "FLOOR"
    TORQUE_INFEASIBLE = "TORQUE_INFEASIBLE"
    UNSTABLE_POSE = "UNSTABLE_POSE"
    THERMAL_HEADROOM = "THERMAL_HEADROOM"
    VOLTAGE_LOW = "VOLTAGE_LOW"
    BUSY = "BUSY"
    ESTOP = "ESTOP"
    LOOP_LATE = "LOOP_LATE"
    LEASE_LOST = "LEASE_LOST"
    STREAM_STALE = "STREAM_STALE"
    STREAM_STOPPED = "STREAM_STOPPED"
    STATE_STALE = "STATE_STALE"
    BUS_ERRORS = "BUS_ERRORS"
    RX_SHAPE = "RX_SHAPE"
    FOREIGN_TRAFFIC = "FOREIGN_TRAFFIC"
    SERVO_ALERT = "SERVO_ALERT"
    TORQUE_MISMATCH = "TORQUE_MISMATCH"
    SERVO_REBOOTED = "SERVO_REBOOTED"
    WATCHDOG_TRIPPED = "WATCHDOG_TRIPPED"
    SENSE_JUMP = "SENSE_JUMP"
    OUT_OF_LIMIT = "OUT_OF_LIMIT"
    FOLLOW_ERR = "FOLLOW_ERR"
    LEAD_LIMIT = "LEAD_LIMIT"  # a goal too far ahead of a joint whose device has no watchdog
    SENSE_FROZEN = "SENSE_FROZEN"  # an encoder that stands still while its motor works
    OVERSPEED = "OVERSPEED"
    OVERCURRENT = "OVERCURRENT"
    OVERTEMP = "OVERTEMP"
    VOLTAGE = "VOLTAGE"
    LOOKAHEAD_COLLISION = "LOOKAHEAD_COLLISION"
    CONTACT = "CONTACT"  # torque from outside, reported only
    CONTACT_HOLD = "CONTACT_HOLD"  # torque from outside beyond `gate.contact.hold_nm`
    DETECTION_LOST = "DETECTION_LOST"  # contacts or falls cannot be detected: readings lack
    STEP_LIMIT = "STEP_LIMIT"
    WIRE_CLAMP = "WIRE_CLAMP"
    TX_BACKLOG = "TX_BACKLOG"
    CAN_BUS_STATE = "CAN_BUS_STATE"
    MIRROR_DRIFT = "MIRROR_DRIFT"
    FALLING = "FALLING"
    INTERNAL = "INTERNAL"
    TIME_GAP = "TIME_GAP"  # the machine was suspended, or the daemon stopped, for longer than a watchdog
    SOCKETS_GONE = "SOCKETS_GONE"  # clients cannot connect: no client could stop a motion
    SUPPLY_RELAY = "SUPPLY_RELAY"  # the supply relay, or its effect on the supply
    PORT_LOST = "PORT_LOST"
    PORT_UNAVAILABLE = "PORT_UNAVAILABLE"
    DEVICE_MISSING = "DEVICE_MISSING"
    DEVICE_MISMATCH = "DEVICE_MISMATCH"
    ARM_FAILED = "ARM_FAILED"
    STOP_NOT_FOUND = "STOP_NOT_FOUND"  # a joint driven against its stop did not meet it as expected
    TORQUE_INHERITED = "TORQUE_INHERITED"
    CONFIG_REFUSED = "CONFIG_REFUSED"  # files, or changes of them, that are refused: the old stay in force
    PATH_TOLERANCE = "PATH_TOLERANCE"
    GOAL_TOLERANCE = "GOAL_TOLERANCE"


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding. `joint` is an index until the edge names it; `message` adds what the numbers lack."""

    code: ReasonCode
    joint: int | None = None
    point: int | None = None  # index of the trajectory point at or after which it happens
    time: float | None = None  # s from the trajectory's start
    value: float | None = None
    bound: float | None = None
    message: str = ""


@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict of the gate. Accepted when there are no refusals."""

    refusals: tuple[Finding, ...] = field(default=())
    warnings: tuple[Finding, ...] = field(default=())
    changes: tuple[Finding, ...] = field(default=())

    @property
    def accepted(self) -> bool:
        """True without a refusal."""
        return not self.refusals
