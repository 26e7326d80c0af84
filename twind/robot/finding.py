"""Why something was refused, warned of or changed: a value, never an exception."""

from dataclasses import dataclass, field
from enum import StrEnum


class ReasonCode(StrEnum):
    """Every reason code. Submit time S01–S28, run time R01–R26; causes and remedies: docs/reason-codes.md."""

    FRAME_TOO_LARGE = "FRAME_TOO_LARGE"  # S01
    RATE_LIMIT = "RATE_LIMIT"  # S01
    BAD_JSON = "BAD_JSON"  # S02
    BAD_SCHEMA = "BAD_SCHEMA"  # S03
    AUTH_ROLE = "AUTH_ROLE"  # S04
    LEASE_MISSING = "LEASE_MISSING"  # S05
    ESTOP_LATCHED = "ESTOP_LATCHED"  # S06
    FAULT_LATCHED = "FAULT_LATCHED"  # S06
    MODE_DENIES = "MODE_DENIES"  # S07
    NOT_ARMED = "NOT_ARMED"  # S08
    CALIB_MISSING = "CALIB_MISSING"  # S09
    CALIB_MISMATCH = "CALIB_MISMATCH"  # S09
    HW_DISCONNECTED = "HW_DISCONNECTED"  # S10
    LATENCY_WARN = "LATENCY_WARN"  # S11
    LATENCY_BLOCK = "LATENCY_BLOCK"  # S11
    CMD_EXPIRED = "CMD_EXPIRED"  # S12
    TOO_DISTANT = "TOO_DISTANT"  # S12
    EMPTY = "EMPTY"  # S13
    NO_JOINTS = "NO_JOINTS"  # S13
    UNKNOWN_JOINT = "UNKNOWN_JOINT"  # S13
    DUP_JOINT = "DUP_JOINT"  # S13
    BAD_SHAPE = "BAD_SHAPE"  # S14
    TOO_MANY_POINTS = "TOO_MANY_POINTS"  # S14
    NONFINITE = "NONFINITE"  # S15
    TIME_ORDER = "TIME_ORDER"  # S16
    POS_LIMIT = "POS_LIMIT"  # S17
    START_JUMP = "START_JUMP"  # S18
    VEL_LIMIT = "VEL_LIMIT"  # S19
    ACC_LIMIT = "ACC_LIMIT"  # S20
    JERK_LIMIT = "JERK_LIMIT"  # S20
    BRAKE_DISTANCE = "BRAKE_DISTANCE"  # S21
    END_NOT_AT_REST = "END_NOT_AT_REST"  # S22
    RETIMED = "RETIMED"  # a change, not a refusal: policy `retime`
    STOP_APPENDED = "STOP_APPENDED"  # a change: `append_stop`
    SELF_COLLISION = "SELF_COLLISION"  # S23
    KEEP_OUT = "KEEP_OUT"  # S24: the world's geometry
    FLOOR = "FLOOR"  # S24
    TORQUE_INFEASIBLE = "TORQUE_INFEASIBLE"  # S25
    UNSTABLE_POSE = "UNSTABLE_POSE"  # S26
    THERMAL_HEADROOM = "THERMAL_HEADROOM"  # S27
    VOLTAGE_LOW = "VOLTAGE_LOW"  # S27
    BUSY = "BUSY"  # S28
    ESTOP = "ESTOP"  # R01
    LOOP_LATE = "LOOP_LATE"  # R02
    LEASE_LOST = "LEASE_LOST"  # R03
    STREAM_STALE = "STREAM_STALE"  # R04
    STATE_STALE = "STATE_STALE"  # R05
    BUS_ERRORS = "BUS_ERRORS"  # R06
    RX_SHAPE = "RX_SHAPE"  # R07
    FOREIGN_TRAFFIC = "FOREIGN_TRAFFIC"  # R08
    SERVO_ALERT = "SERVO_ALERT"  # R09
    TORQUE_MISMATCH = "TORQUE_MISMATCH"  # R10
    SERVO_REBOOTED = "SERVO_REBOOTED"  # R11
    WATCHDOG_TRIPPED = "WATCHDOG_TRIPPED"  # R12
    SENSE_JUMP = "SENSE_JUMP"  # R13
    OUT_OF_LIMIT = "OUT_OF_LIMIT"  # R14
    FOLLOW_ERR = "FOLLOW_ERR"  # R15
    SENSE_FROZEN = "SENSE_FROZEN"  # R15: an encoder that stands still while its motor works
    OVERSPEED = "OVERSPEED"  # R16
    OVERCURRENT = "OVERCURRENT"  # R17
    OVERTEMP = "OVERTEMP"  # R18
    VOLTAGE = "VOLTAGE"  # R19
    LOOKAHEAD_COLLISION = "LOOKAHEAD_COLLISION"  # R20
    STEP_LIMIT = "STEP_LIMIT"  # R21
    WIRE_CLAMP = "WIRE_CLAMP"  # R22
    TX_BACKLOG = "TX_BACKLOG"  # R23
    CAN_BUS_STATE = "CAN_BUS_STATE"  # R24
    MIRROR_DRIFT = "MIRROR_DRIFT"  # R25
    INTERNAL = "INTERNAL"  # R26
    TIME_GAP = "TIME_GAP"  # the machine was suspended, or the daemon stopped, for longer than a watchdog
    SOCKETS_GONE = "SOCKETS_GONE"  # clients cannot connect: nobody could stop what moves
    PORT_LOST = "PORT_LOST"
    PORT_UNAVAILABLE = "PORT_UNAVAILABLE"
    DEVICE_MISSING = "DEVICE_MISSING"
    DEVICE_MISMATCH = "DEVICE_MISMATCH"
    ARM_FAILED = "ARM_FAILED"
    STOP_NOT_FOUND = "STOP_NOT_FOUND"  # a joint driven against its stop did not meet it as it should
    TORQUE_INHERITED = "TORQUE_INHERITED"
    CONFIG_REFUSED = "CONFIG_REFUSED"  # files, or changes of them, that are not taken: the old stay in force
    PATH_TOLERANCE = "PATH_TOLERANCE"
    GOAL_TOLERANCE = "GOAL_TOLERANCE"


@dataclass(frozen=True, slots=True)
class Finding:
    """One reason. `joint` is an index until the edge names it; `message` says what the numbers cannot."""

    code: ReasonCode
    joint: int | None = None
    point: int | None = None  # index of the trajectory point at or after which it happens
    time: float | None = None  # s from the trajectory's start
    value: float | None = None
    bound: float | None = None
    message: str = ""


@dataclass(frozen=True, slots=True)
class Verdict:
    """The gate's answer. Accepted when there are no refusals."""

    refusals: tuple[Finding, ...] = field(default=())
    warnings: tuple[Finding, ...] = field(default=())
    changes: tuple[Finding, ...] = field(default=())

    @property
    def accepted(self) -> bool:
        """No refusal."""
        return not self.refusals
