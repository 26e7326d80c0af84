"""The complaints about CAN buses and their actuators: rows of the doctor's table, in order of cause."""

from twind.doctor.cautions import ALONE, OTHER_MASTER, RATED, SUPPORT, UNPLUGGED
from twind.doctor.check import Check, Severity

FAULT = Severity.FAULT
WARNING = Severity.WARNING
NOTE = Severity.NOTE

ROWS = (
    Check(
        "CAN_SILENT",
        "no device answers on a CAN bus",
        "nothing is read or moved; frames wait, and leave when power returns",
        "check power, an E-stop that cuts it, termination (60 Ω between the wires), bit rate",
        FAULT,
        caution="make sure that no person works at the robot, and stop the daemon: "
        f"waiting commands move it when power returns; {UNPLUGGED}",
        explains=("CAN_MISSING",),
    ),
    Check(
        "CAN_CONTROLLER",
        "the CAN controller reports errors",
        "frames are corrupt or not acknowledged",
        "check termination at both ends, every bit rate, the cable",
        WARNING,
        caution=UNPLUGGED,
        explains=("CAN_SILENT", "CAN_MISSING"),
    ),
    Check(
        "CAN_MASTER",
        "another master commands actuators of this robot",
        "the joint obeys both masters in turn",
        "end the other program, or unplug its adapter",
        FAULT,
        caution=OTHER_MASTER,
    ),
    Check(
        "CAN_FOREIGN",
        "a CAN actuator is not in the robot file",
        "it is neither commanded nor monitored",
        "add its joint to the robot file, correct its id, or unplug it",
        WARNING,
        caution=f"it may have torque or belong to another robot: {UNPLUGGED}",
    ),
    Check(
        "CAN_MISSING",
        "a CAN actuator does not answer",
        "its joint cannot be read or moved; arming is refused",
        "check cable, power, its id and its `feedback_id` (vendor's tool)",
        FAULT,
        caution=UNPLUGGED,
    ),
    Check(
        "CAN_TWICE",
        "two CAN actuators have one id",
        "both obey every command; their answers alternate",
        "disconnect one, give the other a free id (vendor's tool), reconnect the first",
        FAULT,
        caution=UNPLUGGED,
    ),
    Check(
        "CAN_RANGE",
        "frame ranges of actuator and robot file differ",
        "positions and torques are wrong; arming is refused",
        "correct `ranges` of its type, or its registers by the vendor's tool",
        FAULT,
        caution=ALONE,
    ),
    Check(
        "CAN_MODE",
        "a CAN actuator is in another mode",
        "it ignores commands of its family; arming is refused",
        "set it by the vendor's tool, or `twindctl register write BUS ID NAME VALUE`, torque off",
        FAULT,
        caution=ALONE,
    ),
    Check(
        "CAN_FAULT",
        "a CAN actuator reports a fault",
        "it has no torque, or soon will not",
        "correct the cause; `twindctl reset` and arm clear it; else switch its power off and on",
        FAULT,
        caution=SUPPORT,
    ),
    Check(
        "CAN_TORQUE_ON",
        "a CAN actuator has torque, but is not armed",
        "an ended program left it on: it heats and obeys the next command",
        "stand by; `twindctl disarm` lowers the robot",
        WARNING,
        caution=SUPPORT,
    ),
    Check(
        "CAN_WATCHDOG_OFF",
        "a CAN actuator has torque and no watchdog",
        "if its program dies, it continues the last command",
        "`twindctl arm` sets it, or `twindctl disarm` lets go",
        WARNING,
        caution=SUPPORT,
    ),
    Check(
        "CAN_WATCHDOG_UNVERIFIED",
        "a watchdog cannot be read back",
        "the actuator may continue when the daemon dies: arming warns",
        "set and verify it by the vendor's tool; keep a supply switch within reach",
        NOTE,
        caution=(
            "do not try it out by killing the daemon with hands on the robot: the actuator may continue, "
            "and no stop reaches it"
        ),
    ),
    Check(
        "CAN_VOLTAGE_LOW",
        "the supply of a CAN actuator is low",
        "it grows weak, then restarts during motion",
        (
            "measure the voltage at the actuator with a meter, compare with its page and "
            "`supply` of its type; charge "
            "the battery, use thicker cables or a stronger supply of equal voltage"
        ),
        WARNING,
        caution=RATED,
        explains=("CAN_FAULT",),
    ),
)
