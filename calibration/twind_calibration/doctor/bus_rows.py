"""The complaints about serial buses and who is on them: rows of the doctor's table, in order of cause."""

from twind_calibration.doctor.cautions import ALONE, OTHER_MASTER, UNPLUGGED
from twind_calibration.doctor.complaint import Complaint, Severity

FAULT, WARNING, NOTE = Severity.FAULT, Severity.WARNING, Severity.NOTE

LINE = (
    Complaint(
        "BUS_SILENT",
        "nobody answers on a serial bus",
        "nothing can be read or moved there",
        "is the power on, is the data line plugged in, is it the right port? "
        "`twindctl scan --port PORT` looks for every id at every rate, with the daemon stopped",
        FAULT,
        caution="where the power is off, make sure that no person works at the robot and that no "
        f"daemon commands it; {UNPLUGGED}",
        explains=("SERVO_MISSING",),
    ),
    Complaint(
        "BUS_TALK",
        "bytes come though nobody was asked",
        "another program, another master or noise talks on this line: answers are garbled, and "
        "commands may not be ours",
        "end the other program or unplug the other adapter; with neither, look at termination and ground",
        FAULT,
        caution=OTHER_MASTER,
        explains=("BUS_SILENT", "SERVO_MISSING", "BUS_NOISE", "ID_TWICE"),
    ),
    Complaint(
        "BUS_ECHO",
        "the adapter returns what is sent",
        "the bytes sent take the place of the answer's: the daemon takes them off again, other "
        "programs fail on them",
        "switch the adapter's echo off, or take one that controls the direction itself",
        WARNING,
        caution=UNPLUGGED,
    ),
    Complaint(
        "BUS_NOISE",
        "answers get lost or garbled",
        "each lost answer is a joint whose place is not known for a cycle; many of them hold the robot",
        "look at connectors, the ground between boards, and the length of cables; then a lower `baud`",
        WARNING,
        caution=UNPLUGGED,
    ),
    Complaint(
        "PROTOCOL_OLD",
        "servos speak protocol 1.0",
        "the daemon speaks protocol 2.0 alone: they do not hear it",
        "set them to protocol 2.0 by the vendor's tool (register 13), where the model has it",
        FAULT,
        caution=ALONE,
        explains=("SERVO_MISSING",),
    ),
)

WHO = (
    Complaint(
        "BAUD_WRONG",
        "servos answer at another baud rate than the robot file says",
        "at the rate of the robot file nobody hears them: they are missing",
        "write the rate they have as `baud` of the bus, or give them the robot file's by the "
        "vendor's tool (`twindctl adopt` looks for one servo, at the bus's rate and the factory's alone); "
        "not by `--fix`: which of the two is right, only a person knows",
        FAULT,
        caution=ALONE,
        explains=("SERVO_MISSING", "BUS_SILENT"),
    ),
    Complaint(
        "SERVO_FRESH",
        "a servo as from the factory seems to be the missing one",
        "it answers as id 1 at 57,600 baud, where the daemon never asks",
        "`twindctl adopt JOINT` gives it the id, the rate and the registers of its joint",
        FAULT,
        caution=ALONE,
        explains=("SERVO_MISSING",),
    ),
    Complaint(
        "SERVO_MISSING",
        "a servo does not answer",
        "its joint cannot be read or moved, and nobody can arm",
        "look at its cable and power, and at its id: `twindctl scan` lists which ids of the robot file "
        "answer, and with the daemon stopped `twindctl scan --port PORT` who else is there",
        FAULT,
        caution=UNPLUGGED,
    ),
    Complaint(
        "ID_TWICE",
        "two devices answer as one id",
        "their answers garble each other, and both obey every command",
        "disconnect one of them, give the other a free id, then connect the first again",
        FAULT,
        caution=UNPLUGGED,
        explains=("BUS_NOISE",),
    ),
    Complaint(
        "SERVO_FOREIGN",
        "a servo answers that the robot file does not know",
        "nobody commands or watches it; left energised it stays so, and its id may be a mistake",
        "add its joint to the robot file, give it the id that is meant, or unplug it",
        WARNING,
        caution=f"it may be energised, or belong to another robot: {UNPLUGGED}",
    ),
    Complaint(
        "IMU_SILENT",
        "the IMU does not answer",
        "nobody is told how the robot leans: what balances it must not run; joints do not mind",
        "look at its cable and power, and at `bus` and `id` under `sensors` in the robot file",
        WARNING,
        caution=UNPLUGGED,
    ),
    Complaint(
        "IMU_GRAVITY",
        "at rest the IMU does not feel one g",
        "its registers are not as described, or it is broken: the attitude it gives is wrong",
        "leave the robot alone and look again; then compare `address`, `type` and `lsb_m_s2` of its "
        "acceleration in the robot file with its manual",
        WARNING,
    ),
    Complaint(
        "SERVO_MODEL",
        "another model than the robot file says",
        "its counts, currents and limits mean something else: the daemon refuses to arm",
        "put the right servo there, or correct `device` of its type in the robot file",
        FAULT,
        caution="a servo of another rated voltage burns on this supply: compare both pages before "
        f"you exchange it; {UNPLUGGED}",
    ),
    Complaint(
        "WATCHDOG_UNKNOWN",
        "the firmware has no bus watchdog",
        "if the daemon dies, nothing stops this servo; arming is refused",
        "update its firmware by the vendor's tool",
        FAULT,
        caution="support the robot and switch torque off; an update can set registers back to the "
        "factory's: note id, rate, "
        "homing offset and limits, and calibrate anew afterwards",
    ),
    Complaint(
        "FIRMWARE_SLOW",
        "the firmware does not know the fast read",
        "one such servo makes the whole bus be read the slow way: about twice the time on the wire",
        "update its firmware by the vendor's tool (X430 and X540 from 45, X330 from 46, P from 12)",
        NOTE,
        caution="support the robot and switch torque off; an update can set registers back to the "
        "factory's: note id, rate, "
        "homing offset and limits, and calibrate anew afterwards",
    ),
    Complaint(
        "SECOND_ID",
        "a servo obeys a second id",
        "what is meant for another servo moves this one too, unheard",
        "with torque off write 255 to register 12: `twindctl register write BUS ID "
        "secondary_shadow_id 255`; "
        "not by `--fix`: somebody may have meant it",
        FAULT,
        caution="where two servos turn one joint, the second id keeps them together: leave it, or "
        "they work against "
        "each other",
    ),
)

SPEED = (
    Complaint(
        "BUS_BUDGET",
        "the bus cannot hold the rate as its servos are set",
        "ticks are missed, and readings grow old",
        "shorter return delays, a higher baud rate, newer firmware, another bus, or a lower rate",
        FAULT,
        caution="return delay and baud rate are written servo by servo, with torque off: one that "
        "is left out is lost to the bus",
    ),
    Complaint(
        "RETURN_DELAY",
        "the return delay is longer than the robot file says",
        "every answer waits for it: 500 us, as delivered, take most of a 10 ms cycle from 20 servos",
        "`twindctl register write BUS ID return_delay_time COUNTS` (2 us each), with torque off",
        WARNING,
        caution="the adapter must switch its direction within the delay: on RS-485 try one servo first",
        explains=("BUS_BUDGET",),
    ),
    Complaint(
        "SERVO_SLOW",
        "one servo answers later than the others",
        "the whole bus waits for it in every cycle",
        "look at its cable and its neighbours' connectors; exchange it if it stays so",
        WARNING,
        caution=UNPLUGGED,
    ),
)

ROWS = (*LINE, *WHO, *SPEED)
