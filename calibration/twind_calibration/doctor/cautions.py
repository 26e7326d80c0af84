"""Conditions that several remedies of the doctor share: what to make sure of before they are followed."""

SUPPORT = "support the robot: it is lowered or goes limp"
UNPLUGGED = (
    "support the robot, disarm and switch the supply off before you plug or unplug anything: "
    "a device that does not answer may still hold its joint"
)
OTHER_MASTER = (
    "support the robot, and find out what the other program does: it may hold the robot up; "
    "end it by its own command"
)
OURS = "make sure that the adapter is this robot's: servos of another robot would obey"
ALONE = (
    "switch torque off and support the robot; make sure that the device is this robot's, "
    "and alone with its id on the line: what is written stays after power-off"
)
RATED = "never feed a device above the rated voltage of its model, nor raise a supply that other models share"
ZERO_MOVES = (
    "support the robot and switch torque off; compare with the robot file which of the two is meant: "
    "afterwards the same counts are another angle, so let nothing move before it is calibrated anew"
)
MEANING = (
    "another program may rely on it: what it writes as a speed or a goal means something else afterwards"
)
RAISED = "a limit can be there to protect the joint: raise it to what the joint needs, and no further"
REBOOT = "support the joint: without torque it falls; find the cause first, or it fails again under load"
