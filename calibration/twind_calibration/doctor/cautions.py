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
