"""The complaints about CAN buses and their actuators: rows of the doctor's table, in order of cause."""

from twind_calibration.doctor.cautions import ALONE, OTHER_MASTER, RATED, SUPPORT, UNPLUGGED
from twind_calibration.doctor.complaint import Complaint, Severity

FAULT, WARNING, NOTE = Severity.FAULT, Severity.WARNING, Severity.NOTE

ROWS = (
    Complaint(
        "CAN_SILENT",
        "nobody answers on a CAN bus",
        "nothing can be read or moved there; frames that nobody acknowledges wait, and go out "
        "when power returns",
        "power of the actuators, an E-stop that cuts it, termination (60 ohm between the "
        "wires), the bit rate",
        FAULT,
        caution="make sure that no person works at the robot, and stop the daemon: commands that "
        f"wait move it when power returns; {UNPLUGGED}",
        explains=("CAN_MISSING",),
    ),
    Complaint(
        "CAN_CONTROLLER",
        "the CAN controller is in trouble",
        "frames are broken or not acknowledged by anybody",
        "termination at both ends, the bit rate of every actuator, the cable",
        WARNING,
        caution=UNPLUGGED,
        explains=("CAN_SILENT", "CAN_MISSING"),
    ),
    Complaint(
        "CAN_MASTER",
        "another master commands actuators of this robot",
        "its commands alternate with ours: the joint obeys both",
        "end the other program, or unplug its adapter",
        FAULT,
        caution=OTHER_MASTER,
    ),
    Complaint(
        "CAN_FOREIGN",
        "a CAN actuator talks that the robot file does not know",
        "nobody commands or watches it, and its id may be a mistake",
        "add its joint to the robot file, give it the id that is meant, or unplug it",
        WARNING,
        caution=f"it may be energised, or belong to another robot: {UNPLUGGED}",
    ),
    Complaint(
        "CAN_MISSING",
        "a CAN actuator does not answer",
        "its joint cannot be read or moved, and nobody can arm",
        "its cable and power; its id, and the id that it answers with (`feedback_id`), by the vendor's tool",
        FAULT,
        caution=UNPLUGGED,
    ),
    Complaint(
        "CAN_TWICE",
        "two CAN actuators have one id",
        "both obey every command, and their answers alternate",
        "disconnect one, give the other a free id by the vendor's tool, then connect the first again",
        FAULT,
        caution=UNPLUGGED,
    ),
    Complaint(
        "CAN_RANGE",
        "an actuator's frames span something else than the robot file says",
        "a wrong range is a wrong position and a wrong torque; the daemon refuses to arm",
        "write what the actuator says as `ranges` of its type, or set its registers by the vendor's tool",
        FAULT,
        caution=ALONE,
    ),
    Complaint(
        "CAN_MODE",
        "a CAN actuator is in another mode",
        "it does not take the commands of its family; the daemon refuses to arm",
        "set it by the vendor's tool, or `twindctl register write BUS ID NAME VALUE` with torque off",
        FAULT,
        caution=ALONE,
    ),
    Complaint(
        "CAN_FAULT",
        "a CAN actuator reports a fault",
        "it has no torque, or will soon have none",
        "mend the cause, then `twindctl reset` and arm: that clears what is over; else switch "
        "its power off and on",
        FAULT,
        caution=SUPPORT,
    ),
    Complaint(
        "CAN_TORQUE_ON",
        "a CAN actuator has torque though nobody has armed",
        "an ended program left it on: it heats, and obeys the next command",
        "stand by, then `twindctl disarm` lowers the robot and lets it go",
        WARNING,
        caution=SUPPORT,
    ),
    Complaint(
        "CAN_WATCHDOG_OFF",
        "a CAN actuator has torque and no watchdog",
        "if the program that commands it dies, it goes on with its last command",
        "`twindctl arm` sets it, or `twindctl disarm` lets go",
        WARNING,
        caution=SUPPORT,
    ),
    Complaint(
        "CAN_WATCHDOG_UNVERIFIED",
        "a watchdog that nobody can read back",
        "whether these actuators stop when the daemon dies is known only to who set them: "
        "every arming warns of it",
        "set it by the vendor's tool, read it back there, and keep a switch in the supply within reach",
        NOTE,
        caution="do not try it out by killing the daemon with hands on the robot: an actuator "
        "without it goes on with its "
        "last command, and no stop reaches it",
    ),
    Complaint(
        "CAN_VOLTAGE_LOW",
        "the supply of a CAN actuator is low",
        "it grows weak, then restarts in the middle of a motion",
        "measure the voltage at the actuator with a meter, and compare it and `supply` of its type "
        "with its page; "
        "then charge or change the battery, take thicker cables or a supply of the same voltage "
        "that gives more current",
        WARNING,
        caution=RATED,
        explains=("CAN_FAULT",),
    ),
)
