"""Complaints about settings and states of servos: rows of the doctor's table, in order of cause."""

from twind_calibration.doctor.cautions import MEANING, RAISED, RATED, REBOOT, SUPPORT, ZERO_MOVES
from twind_calibration.doctor.complaint import Complaint, Severity

FAULT, WARNING, NOTE = Severity.FAULT, Severity.WARNING, Severity.NOTE
WRITE = "`twindctl register write BUS ID {0}`, with torque off"
# Why `--fix` leaves a thing alone.
ZERO = "; not by `--fix`: where its zero is, would be another matter afterwards"
MEANT = "; not by `--fix`: somebody may have meant it, and only a person knows"
HOLDS = "; not by `--fix`: a diagnosis changes no torque"
CAUSE = "; not by `--fix`: the cause comes first"

SET = (
    Complaint(
        "STATUS_LEVEL",
        "a servo does not answer everything",
        "at status return level 0 it answers pings alone and cannot be read, at 1 a refused "
        "write goes unseen",
        WRITE.format("status_return_level 2") + "; or switch its power off and on: it wakes up with 2",
        FAULT,
        caution="without its power the joint goes limp: support the robot before you switch it off",
    ),
    Complaint(
        "OPERATING_MODE",
        "another operating mode than the robot file says",
        "its goals would mean something else: the daemon refuses to arm",
        WRITE.format("operating_mode NUMBER")
        + ", then calibrate it anew; or correct `mode` in the robot file"
        + ZERO,
        FAULT,
        caution=ZERO_MOVES,
    ),
    Complaint(
        "TORQUE_BY_GOAL",
        "a goal alone switches torque on",
        "a servo that should be limp moves when a goal is written (drive mode, bit 3); arming is refused",
        WRITE.format("drive_mode VALUE") + ", the value without 8" + MEANT,
        FAULT,
        caution=MEANING,
    ),
    Complaint(
        "TORQUE_AT_BOOT",
        "a servo energises itself when it gets power",
        "it holds or moves with nobody in charge (startup configuration, bit 0); arming is refused",
        WRITE.format("startup_configuration 0") + MEANT,
        FAULT,
        caution="at the next power-on the joint is limp: support what it holds by then",
    ),
    Complaint(
        "RAM_RESTORE",
        "a servo restores an old RAM when it gets power",
        "after every start it may wake up with gains, profiles and answers of somebody else "
        "(startup configuration, bit 1)",
        WRITE.format("startup_configuration 0") + MEANT,
        WARNING,
        caution="both bits go: where torque at power-on was meant, the joint is limp at the next one",
        explains=("STATUS_LEVEL", "WATCHDOG_LEFT", "INDIRECT_LEFT"),
    ),
    Complaint(
        "OFFSET_IGNORED",
        "the homing offset is too large for position mode",
        "beyond 1024 counts position mode ignores it and the others do not: zeros depend on "
        "the mode; arming is refused",
        WRITE.format("homing_offset 0") + ", then calibrate the joint anew" + ZERO,
        FAULT,
        caution=ZERO_MOVES,
    ),
    Complaint(
        "CALIBRATION_CHANGED",
        "a servo is not set as it was when it was calibrated",
        "its zero may be another one: the daemon refuses to arm",
        "write back the value that the calibration names, or calibrate the joint anew" + ZERO,
        FAULT,
        caution="write it back only to the servo that was calibrated: in one that was exchanged, "
        "or whose horn was taken off, "
        "the zero is another one, and the daemon would arm with it; compare with the monitor "
        "before anything moves",
    ),
    Complaint(
        "FIRMWARE_CHANGED",
        "another firmware than when it was calibrated",
        "registers may mean something else, and it may be another servo",
        "move the joint by hand and compare with `twindctl monitor`; then calibrate anew",
        WARNING,
        caution="switch torque off and support the robot before you move a joint by hand",
    ),
    Complaint(
        "REVERSED",
        "a servo turns the other way round by its own register",
        "in reverse mode position and current may have different signs (drive mode, bit 0): "
        "torque is judged wrongly",
        "turn the sign in the robot file instead: "
        + WRITE.format("drive_mode VALUE")
        + ", then calibrate anew"
        + ZERO,
        NOTE,
        caution=ZERO_MOVES,
    ),
    Complaint(
        "PROFILE_IN_TIME",
        "profiles are times, not speeds",
        "drive mode, bit 2: what other programs write as a speed is taken for milliseconds",
        WRITE.format("drive_mode VALUE") + ", the value without 4" + MEANT,
        WARNING,
        caution=MEANING,
    ),
    Complaint(
        "REGISTER_DIFFERS",
        "a register is not what the robot file asks for",
        "the robot file demands it under `registers`: the daemon refuses to arm",
        WRITE.format("NAME VALUE") + ", or correct `registers` in the robot file" + MEANT,
        FAULT,
        caution="the robot file can be wrong: compare the value with the model's page, above all a "
        "limit that it raises",
    ),
)

LIMITS = (
    Complaint(
        "FENCE_TIGHT",
        "the servo's own position limits are tighter than its joint",
        "goals beyond them are refused by the servo: the joint stops short while the daemon "
        "thinks that it moves",
        "where the calibration has wider ones: "
        + WRITE.format("min_position_limit COUNTS")
        + ", and max_position_limit; else calibrate the joint anew, or tighten `limits_rad`"
        + MEANT,
        FAULT,
        caution="a limit can be there for a stop or a cable: with torque off, move the joint by "
        "hand over its whole range first",
    ),
    Complaint(
        "LIMIT_ZERO",
        "a limit of the servo is zero",
        "it takes torque and goals, and never moves",
        WRITE.format("NAME COUNTS") + "; the robot file or the model's page says how many" + MEANT,
        FAULT,
        caution=RAISED,
    ),
    Complaint(
        "CURRENT_CAP",
        "the servo allows less current than the robot file wants",
        "in current-based position mode its cap is refused: arming fails",
        "lower `current_limit_a` of its type, or " + WRITE.format("current_limit COUNTS") + MEANT,
        FAULT,
        caution=RAISED,
    ),
    Complaint(
        "SHUTDOWN_MASK",
        "a servo does not protect itself",
        "overload, heat or a shock do not switch it off (shutdown, register 63): it burns instead",
        WRITE.format("shutdown VALUE")
        + ", bits 4 heat, 16 shock, 32 overload; who wants another mask, writes "
        "it under `registers` in the robot file" + MEANT,
        FAULT,
        caution="a servo that shuts down drops what it holds: where that is worse, support the "
        "joint or keep the mask",
    ),
    Complaint(
        "PROFILE_LEFT",
        "a profile was left in a servo",
        "arming sets it to 0; until then another program's goals are followed slowly",
        "nothing for the daemon's sake; for another program, what that one needs" + MEANT,
        NOTE,
    ),
    Complaint(
        "INDIRECT_LEFT",
        "indirect addresses were set by somebody",
        "the daemon does not use them; a program that trusts them reads and writes other registers",
        "nothing for the daemon's sake; for another program, what that one needs",
        NOTE,
    ),
)

STATE = (
    Complaint(
        "VOLTAGE_LOW",
        "the supply is low",
        "servos grow weak, then restart in the middle of a motion",
        "measure the voltage at the servo with a meter, and compare it with the model's page; then "
        "charge or "
        "change the battery, take thicker cables or a supply of the same voltage that gives more current",
        WARNING,
        caution=RATED,
        explains=("ERROR_VOLTAGE",),
    ),
    Complaint(
        "VOLTAGE_HIGH",
        "the supply is high",
        "servos are damaged above what they are made for",
        "disarm and switch the supply off; measure it with a meter, then take one of the right voltage",
        FAULT,
        caution=SUPPORT,
        explains=("ERROR_VOLTAGE",),
    ),
    Complaint(
        "VOLTAGE_BOUNDS",
        "the bounds of a servo's supply exclude each other",
        "no supply fits them: to follow the lower bound burns the servo",
        "leave the supply as it is; correct `supply` of its type in the robot file, or its registers "
        "min_voltage_limit (34) and max_voltage_limit (32), by the model's page",
        FAULT,
    ),
    Complaint(
        "VOLTAGE_DROP",
        "servos get less voltage than the others of their type on this bus",
        "a thin cable or a bad connector: under load these servos restart first",
        "measure the voltage at the first of these servos with a meter; where it is as low, look at the "
        "cables and connectors before it; feed a long chain at both ends from the same supply",
        WARNING,
        caution="do not raise the supply: the others would get more than they measure now",
        explains=("VOLTAGE_LOW",),
    ),
    Complaint(
        "ERROR_OVERLOAD",
        "a servo has shut itself down: overload",
        "it has no torque, and takes none before a restart",
        "relieve the joint: something blocks it, or it carries too much; then `twindctl reboot BUS ID`"
        + CAUSE,
        FAULT,
        caution=REBOOT,
    ),
    Complaint(
        "ERROR_HEAT",
        "a servo has shut itself down: overheating",
        "it has no torque, and takes none before a restart",
        "let it cool, and look for the load that warmed it; then `twindctl reboot BUS ID`" + CAUSE,
        FAULT,
        caution=REBOOT,
    ),
    Complaint(
        "ERROR_VOLTAGE",
        "a servo met a voltage outside its limits",
        "the supply sagged or rose; where the shutdown mask says so, it has no torque",
        "mend the supply, then `twindctl reboot BUS ID`" + CAUSE,
        FAULT,
        caution=REBOOT,
    ),
    Complaint(
        "ERROR_ENCODER",
        "a servo's encoder failed",
        "it does not know where it is: its position must not be used",
        "`twindctl reboot BUS ID`; if it comes back, exchange the servo" + CAUSE,
        FAULT,
        caution=f"{REBOOT}; compare its position with the joint before you arm, even where the error is gone",
    ),
    Complaint(
        "ERROR_SHOCK",
        "a servo met an electrical shock, or its motor gets too little power",
        "it has no torque, and takes none before a restart",
        "look at the supply's current and the connectors; then `twindctl reboot BUS ID`" + CAUSE,
        FAULT,
        caution=REBOOT,
    ),
    Complaint(
        "SERVO_HOT",
        "a servo is hot",
        "near its limit it shuts itself down, and the joint goes limp",
        "let it rest; look for a joint that carries weight in its rest pose, or that something blocks",
        WARNING,
        caution=SUPPORT,
        explains=("ERROR_HEAT",),
    ),
    Complaint(
        "TORQUE_ON",
        "torque is on though nobody has armed",
        "an ended program left it on: the motor heats, and whoever writes a goal moves it",
        "stand by, then `twindctl arm` takes it over without a step, or `twindctl disarm` "
        "lowers the robot and lets it go" + HOLDS,
        WARNING,
        caution=SUPPORT,
    ),
    Complaint(
        "WATCHDOG_TRIPPED",
        "the bus watchdog has tripped with torque on",
        "the servo stands still with torque and takes no goals: its master died or stalled",
        "`twindctl disarm` lowers it and lets it go, then `twindctl reset`" + HOLDS,
        FAULT,
        caution=SUPPORT,
    ),
    Complaint(
        "WATCHDOG_OFF",
        "torque is on without a bus watchdog",
        "if the program that commands it dies, nothing stops it",
        "`twindctl arm` sets it, or `twindctl disarm` lets go" + HOLDS,
        WARNING,
        caution=SUPPORT,
    ),
    Complaint(
        "WATCHDOG_LEFT",
        "a bus watchdog was left set",
        "arming sets it anew; until then the servo refuses goals of other programs (error 4)",
        WRITE.format("bus_watchdog 0"),
        NOTE,
        caution="end the program that set it first: it relies on it to stop the servo",
    ),
)

ROWS = (*SET, *LIMITS, *STATE)
