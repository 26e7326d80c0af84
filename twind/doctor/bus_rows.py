"""The complaints about serial buses and who is on them: rows of the doctor's table, in order of cause."""

from twind.doctor.cautions import ALONE, FIRMWARE, OTHER_MASTER, UNPLUGGED
from twind.doctor.check import Check, Severity

FAULT = Severity.FAULT
WARNING = Severity.WARNING
NOTE = Severity.NOTE

LINE = (
    Check(
        "BUS_SILENT",
        "no device answers on a serial bus",
        "the daemon can neither read nor move its joints",
        (
            "check power, data line and port; daemon stopped: `twindctl scan --port PORT` tries every id "
            "and rate"
        ),
        FAULT,
        caution="if the power is off: make sure that no person works at the robot and no daemon commands it; "
        f"{UNPLUGGED}",
        explains=("SERVO_MISSING",),
    ),
    Check(
        "BUS_TALK",
        "unrequested bytes arrive",
        "another master or noise: answers are corrupt, commands may be foreign",
        "end the other program or unplug its adapter; else check termination and ground",
        FAULT,
        caution=OTHER_MASTER,
        explains=("BUS_SILENT", "SERVO_MISSING", "BUS_NOISE", "ID_TWICE"),
    ),
    Check(
        "BUS_ECHO",
        "the adapter echoes sent bytes",
        "the daemon removes the echo; other programs fail",
        "switch the echo off, or use an adapter that controls direction",
        WARNING,
        caution=UNPLUGGED,
    ),
    Check(
        "BUS_NOISE",
        "answers are lost or corrupt",
        "each loss leaves a joint unknown for a cycle; many cause HOLD",
        "check connectors, ground between boards, cable length; then a lower `baud`",
        WARNING,
        caution=UNPLUGGED,
    ),
    Check(
        "PROTOCOL_OLD",
        "servos use protocol 1.0",
        "the daemon uses protocol 2.0 only: they do not answer",
        "set protocol 2.0 by the vendor's tool (register 13), if the model has it",
        FAULT,
        caution=ALONE,
        explains=("SERVO_MISSING",),
    ),
)

WHO = (
    Check(
        "BAUD_WRONG",
        "servos answer at another baud rate than the robot file's",
        "at the rate of the robot file they do not answer",
        (
            "set their rate as `baud`, or the robot file's rate by the vendor's tool (`twindctl adopt` "
            "for one servo at bus or factory rate); not by `--fix`: either may be intended"
        ),
        FAULT,
        caution=ALONE,
        explains=("SERVO_MISSING", "BUS_SILENT"),
    ),
    Check(
        "SERVO_FRESH",
        "a factory-new servo seems to be the missing one",
        "it answers as id 1 at 57,600 baud, which the daemon does not use",
        "`twindctl adopt JOINT` writes its id, rate and registers",
        FAULT,
        caution=ALONE,
        explains=("SERVO_MISSING",),
    ),
    Check(
        "SERVO_MISSING",
        "a servo does not answer",
        "its joint cannot be read or moved; arming is refused",
        "check cable, power and id: `twindctl scan`; daemon stopped: `twindctl scan --port PORT`",
        FAULT,
        caution=UNPLUGGED,
    ),
    Check(
        "ID_TWICE",
        "two devices have one id",
        "their answers collide, and both obey every command",
        "disconnect one, give the other a free id, reconnect the first",
        FAULT,
        caution=UNPLUGGED,
        explains=("BUS_NOISE",),
    ),
    Check(
        "SERVO_FOREIGN",
        "a servo is not in the robot file",
        "it is neither commanded nor monitored, and may have torque",
        "add its joint to the robot file, correct its id, or unplug it",
        WARNING,
        caution=f"it may have torque or belong to another robot: {UNPLUGGED}",
    ),
    Check(
        "IMU_SILENT",
        "the IMU does not answer",
        "balancing programs must not run; joints are not affected",
        "check cable, power, and `bus` and `id` under `sensors` in the robot file",
        WARNING,
        caution=UNPLUGGED,
    ),
    Check(
        "IMU_GRAVITY",
        "at rest the IMU does not measure 1 g",
        "registers are described wrongly or it is broken: attitude is wrong",
        "repeat at rest; compare `address`, `type`, `lsb_m_s2` of its acceleration with the manual",
        WARNING,
    ),
    Check(
        "SERVO_MODEL",
        "another model than the robot file says",
        "counts, currents and limits differ: arming is refused",
        "exchange the servo, or correct `device` of its type",
        FAULT,
        caution="a servo of another rated voltage burns on this supply: compare both pages before "
        "you exchange it; "
        f"{UNPLUGGED}",
    ),
    Check(
        "WATCHDOG_UNKNOWN",
        "the firmware has no bus watchdog",
        "if the daemon dies, this servo does not stop; arming is refused",
        "update its firmware by the vendor's tool",
        FAULT,
        caution=FIRMWARE,
    ),
    Check(
        "FIRMWARE_SLOW",
        "the firmware lacks the fast read",
        "one such servo doubles the bus time of all",
        "update its firmware by the vendor's tool (X430 and X540 from 45, X330 from 46, P from 12)",
        NOTE,
        caution=FIRMWARE,
    ),
    Check(
        "SECOND_ID",
        "a servo obeys a second id",
        "it silently obeys another servo's commands",
        (
            "`twindctl register write BUS ID secondary_shadow_id 255` (register 12), torque off; not by "
            "`--fix`: it may be intended"
        ),
        FAULT,
        caution="where two servos turn one joint, the second id couples them: leave it",
    ),
)

SPEED = (
    Check(
        "BUS_BUDGET",
        "the bus cannot hold the rate",
        "ticks are missed and readings grow old",
        "shorter return delays, higher baud rate, newer firmware, another bus, or a lower rate",
        FAULT,
        caution="write return delay and baud rate to every servo, torque off: one left out is lost",
    ),
    Check(
        "RETURN_DELAY",
        "the return delay exceeds the robot file's",
        "every answer waits: 500 us take most of a 10 ms cycle of 20 servos",
        "`twindctl register write BUS ID return_delay_time COUNTS` (2 us each), torque off",
        WARNING,
        caution="the adapter must switch direction within the delay: on RS-485 try one servo first",
        explains=("BUS_BUDGET",),
    ),
    Check(
        "SERVO_SLOW",
        "one servo answers later than the others",
        "the whole bus waits for it",
        "check its cable and its neighbours' connectors; else exchange it",
        WARNING,
        caution=UNPLUGGED,
    ),
)

ROWS = (*LINE, *WHO, *SPEED)
