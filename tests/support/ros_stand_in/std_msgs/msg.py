"""Types of the stand-in."""

from stand_in_messages import message

Header = message("std_msgs/msg/Header")
String = message("std_msgs/msg/String")
Float64 = message("std_msgs/msg/Float64")
Float64MultiArray = message("std_msgs/msg/Float64MultiArray")
