"""Types of the stand-in."""

from stand_in_messages import message

TFMessage = message("tf2_msgs/msg/TFMessage")
