"""Types of the stand-in."""

from stand_in_messages import message

Clock = message("rosgraph_msgs/msg/Clock")
