"""Types of the stand-in."""

from stand_in_messages import message

JointTolerance = message("control_msgs/msg/JointTolerance")
DynamicJointState = message("control_msgs/msg/DynamicJointState")
