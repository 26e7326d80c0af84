"""Complaints about settings and states of servos: rows of the doctor's table, in order of cause."""

from twind.doctor.cautions import MEANING, RAISED, RATED, REBOOT, SUPPORT, ZERO_MOVES
from twind.doctor.check import Check, Severity

FAULT = Severity.FAULT
WARNING = Severity.WARNING
NOTE = Severity.NOTE
WRITE = "`twindctl register write BUS ID {0}`, torque off"
# Why `--fix` leaves a thing alone.
ZERO = "; not by `--fix`: the zero changes"
MEANT = "; not by `--fix`: it may be intended"
HOLDS = "; not by `--fix`: it would change torque"
CAUSE = "; not by `--fix`: find the cause first"

SET = (
    Check(
        "STATUS_LEVEL",
        "a servo does not answer all requests",
        "level 0 answers pings only; level 1 hides refused writes",
        WRITE.format("status_return_level 2") + "; or power it off and on",
        FAULT,
        caution="without power the joint goes limp: support the robot first",
    ),
    Check(
        "OPERATING_MODE",
        "another operating mode than the robot file says",
        "goals have another meaning: arming is refused",
        WRITE.format("operating_mode NUMBER")
        + ", then calibrate; or correct `mode` in the robot file"
        + ZERO,
        FAULT,
        caution=ZERO_MOVES,
    ),
    Check(
        "TORQUE_BY_GOAL",
        "a goal alone switches torque on",
        "a limp servo moves when it receives a goal (drive mode, bit 3); arming is refused",
        WRITE.format("drive_mode VALUE") + ", the value without 8" + MEANT,
        FAULT,
        caution=MEANING,
    ),
    Check(
        "TORQUE_AT_BOOT",
        "a servo switches torque on at power-on",
        "it moves without a daemon (startup configuration, bit 0); arming is refused",
        WRITE.format("startup_configuration 0") + MEANT,
        FAULT,
        caution="at the next power-on the joint is limp: support it",
    ),
    Check(
        "RAM_RESTORE",
        "a servo restores saved RAM at power-on",
        "it starts with foreign gains and profiles (startup configuration, bit 1)",
        WRITE.format("startup_configuration 0") + MEANT,
        WARNING,
        caution="both bits are cleared: without torque at power-on the joint is limp",
        explains=("STATUS_LEVEL", "WATCHDOG_LEFT", "INDIRECT_LEFT"),
    ),
    Check(
        "OFFSET_IGNORED",
        "the homing offset is too large for position mode",
        "beyond 1024 counts position mode ignores it: zeros depend on the mode; arming is refused",
        WRITE.format("homing_offset 0") + ", then calibrate the joint" + ZERO,
        FAULT,
        caution=ZERO_MOVES,
    ),
    Check(
        "CALIBRATION_CHANGED",
        "a servo differs from its calibration",
        "its zero may differ: arming is refused",
        "restore the calibrated value, or calibrate the joint" + ZERO,
        FAULT,
        caution=(
            "restore only to the servo that was calibrated: after an exchange or a removed horn the zero "
            "differs; compare with the monitor before any motion"
        ),
    ),
    Check(
        "FIRMWARE_CHANGED",
        "the firmware changed since calibration",
        "registers may differ; it may be another servo",
        "move the joint by hand and compare with `twindctl monitor`; then calibrate",
        WARNING,
        caution="switch torque off and support the robot first",
    ),
    Check(
        "REVERSED",
        "a servo is reversed by its own register",
        "position and current may differ in sign (drive mode, bit 0): torque is misjudged",
        "use the sign in the robot file: " + WRITE.format("drive_mode VALUE") + ", then calibrate" + ZERO,
        NOTE,
        caution=ZERO_MOVES,
    ),
    Check(
        "PROFILE_IN_TIME",
        "profiles are times, not speeds",
        "other programs' speeds are taken as milliseconds (drive mode, bit 2)",
        WRITE.format("drive_mode VALUE") + ", the value without 4" + MEANT,
        WARNING,
        caution=MEANING,
    ),
    Check(
        "REGISTER_DIFFERS",
        "a register differs from the robot file's `registers`",
        "arming is refused",
        WRITE.format("NAME VALUE") + ", or correct the robot file" + MEANT,
        FAULT,
        caution="the robot file may be wrong: compare with the model's page, limits above all",
    ),
)

LIMITS = (
    Check(
        "FENCE_TIGHT",
        "the servo's position limits are tighter than the joint's",
        "the servo refuses goals beyond them and stops short",
        "if the calibration is wider: "
        + WRITE.format("min_position_limit COUNTS")
        + ", and max_position_limit; else calibrate, or tighten `limits_rad`"
        + MEANT,
        FAULT,
        caution="a limit may protect an endstop or cable: torque off, move the joint over its range first",
    ),
    Check(
        "LIMIT_ZERO",
        "a limit of the servo is zero",
        "it accepts torque and goals, and never moves",
        WRITE.format("NAME COUNTS") + "; see robot file or model page" + MEANT,
        FAULT,
        caution=RAISED,
    ),
    Check(
        "CURRENT_CAP",
        "the servo allows less current than the robot file",
        "current-based position mode refuses the value: arming fails",
        "lower `current_limit_a` of its type, or " + WRITE.format("current_limit COUNTS") + MEANT,
        FAULT,
        caution=RAISED,
    ),
    Check(
        "SHUTDOWN_MASK",
        "a servo does not protect itself",
        "no shutdown at overload, heat or shock (register 63): it burns",
        WRITE.format("shutdown VALUE")
        + ", bits 4 heat, 16 shock, 32 overload; another mask: `registers` in the robot file"
        + MEANT,
        FAULT,
        caution=(
            "a servo that shuts down drops its load: where that is worse, support the joint or keep the mask"
        ),
    ),
    Check(
        "PROFILE_LEFT",
        "a servo has a profile set",
        "arming sets 0; until then other programs move it slowly",
        "none for the daemon" + MEANT,
        NOTE,
    ),
    Check(
        "INDIRECT_LEFT",
        "indirect addresses are set",
        "the daemon ignores them; a program that trusts them uses other registers",
        "none for the daemon",
        NOTE,
    ),
)

STATE = (
    Check(
        "VOLTAGE_LOW",
        "the supply is low",
        "servos grow weak, then restart during motion",
        (
            "measure the voltage at the servo with a meter, compare with its page; charge or "
            "change the battery, use thicker "
            "cables or a stronger supply of equal voltage"
        ),
        WARNING,
        caution=RATED,
        explains=("ERROR_VOLTAGE",),
    ),
    Check(
        "VOLTAGE_HIGH",
        "the supply is high",
        "too much voltage damages servos",
        "disarm, switch the supply off; measure it, use one of the right voltage",
        FAULT,
        caution=SUPPORT,
        explains=("ERROR_VOLTAGE",),
    ),
    Check(
        "VOLTAGE_BOUNDS",
        "a servo's supply bounds contradict each other",
        "no supply fits: the lower bound would burn the servo",
        (
            "leave the supply as it is; correct `supply` of its type, or min_voltage_limit "
            "(34), max_voltage_limit "
            "(32), by the model's page"
        ),
        FAULT,
    ),
    Check(
        "VOLTAGE_DROP",
        "servos get less voltage than others on this bus",
        "thin cable or bad connector: these servos restart first",
        (
            "measure the voltage at the first of them; if low, check cables and connectors "
            "before it; feed long "
            "chains at both ends from one supply"
        ),
        WARNING,
        caution="do not raise the supply: the others would get too much",
        explains=("VOLTAGE_LOW",),
    ),
    Check(
        "ERROR_OVERLOAD",
        "a servo has shut itself down: overload",
        "no torque until a restart",
        "remove the obstacle or load; then `twindctl reboot BUS ID`" + CAUSE,
        FAULT,
        caution=REBOOT,
    ),
    Check(
        "ERROR_HEAT",
        "a servo has shut itself down: overheating",
        "no torque until a restart",
        "let it cool, find the load; then `twindctl reboot BUS ID`" + CAUSE,
        FAULT,
        caution=REBOOT,
    ),
    Check(
        "ERROR_VOLTAGE",
        "a servo measured a voltage outside its limits",
        "the supply varied; with the shutdown mask it has no torque",
        "correct the supply, then `twindctl reboot BUS ID`" + CAUSE,
        FAULT,
        caution=REBOOT,
    ),
    Check(
        "ERROR_ENCODER",
        "a servo's encoder failed",
        "its position must not be used",
        "`twindctl reboot BUS ID`; if it comes back, exchange the servo" + CAUSE,
        FAULT,
        caution=f"{REBOOT}; compare its position with the joint before you arm",
    ),
    Check(
        "ERROR_SHOCK",
        "a servo reports electrical shock or too little motor power",
        "no torque until a restart",
        "check supply current and connectors; then `twindctl reboot BUS ID`" + CAUSE,
        FAULT,
        caution=REBOOT,
    ),
    Check(
        "SERVO_HOT",
        "a servo is hot",
        "near its limit it shuts down, and the joint goes limp",
        "let it rest; look for weight in the rest pose or an obstacle",
        WARNING,
        caution=SUPPORT,
        explains=("ERROR_HEAT",),
    ),
    Check(
        "TORQUE_ON",
        "torque is on, but not armed",
        "an ended program left it on: it heats, and any goal moves it",
        "stand by: `twindctl arm` takes it over without a step, `twindctl disarm` lowers the robot" + HOLDS,
        WARNING,
        caution=SUPPORT,
    ),
    Check(
        "WATCHDOG_TRIPPED",
        "the bus watchdog tripped with torque on",
        "it holds and accepts no goals: its master died or stalled",
        "`twindctl disarm` lowers it, then `twindctl reset`" + HOLDS,
        FAULT,
        caution=SUPPORT,
    ),
    Check(
        "WATCHDOG_OFF",
        "torque is on without a bus watchdog",
        "if its program dies, it does not stop",
        "`twindctl arm` sets it, or `twindctl disarm` lets go" + HOLDS,
        WARNING,
        caution=SUPPORT,
    ),
    Check(
        "WATCHDOG_LEFT",
        "a bus watchdog is set",
        "arming sets it; until then goals of other programs fail (error 4)",
        WRITE.format("bus_watchdog 0"),
        NOTE,
        caution="disarming leaves it set; if another program set it, end that program first: "
        "it relies on it to stop",
    ),
)

ROWS = (*SET, *LIMITS, *STATE)
