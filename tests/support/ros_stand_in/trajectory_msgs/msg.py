"""Types of the stand-in."""

from stand_in_messages import message

JointTrajectory = message("trajectory_msgs/msg/JointTrajectory")
JointTrajectoryPoint = message("trajectory_msgs/msg/JointTrajectoryPoint")
