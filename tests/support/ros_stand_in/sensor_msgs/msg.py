"""Types of the stand-in."""

from stand_in_messages import message

JointState = message("sensor_msgs/msg/JointState")
Imu = message("sensor_msgs/msg/Imu")
