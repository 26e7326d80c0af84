"""Conditions that several remedies of the doctor share: what to make sure of before they are followed."""

SUPPORT = "support the robot: it is lowered or goes limp"
UNPLUGGED = (
    "support the robot, disarm, switch the supply off before plugging: "
    "a silent device may still hold its joint"
)
OTHER_MASTER = "support the robot: the other program may hold it up; end it by its own command"
OURS = "make sure that the adapter is this robot's: servos of another robot would obey"
ALONE = (
    "switch torque off and support the robot; make sure that the device is this robot's "
    "and its id unique: the change is permanent"
)
RATED = "never feed a device above the rated voltage of its model, nor raise a supply that other models share"
ZERO_MOVES = (
    "support the robot without torque; check which value is meant: angles change, "
    "so calibrate before any motion"
)
MEANING = "another program may rely on it and would misread speeds or goals afterwards"
RAISED = "a limit may protect the joint: raise it to what the joint needs, and no further"
REBOOT = "support the joint: without torque it falls; find the cause first, or it fails again"
FIRMWARE = (
    "support the robot without torque; an update can reset registers: "
    "note id, rate, homing offset, limits; calibrate afterwards"
)
BIT_RATE = "check the actuators' rate: a wrong one destroys the frames of all devices"
