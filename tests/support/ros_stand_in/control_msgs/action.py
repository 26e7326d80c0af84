"""Types of the stand-in."""

from stand_in_messages import action

FollowJointTrajectory = action("control_msgs/action/FollowJointTrajectory")
