"""`twindctl ros`: the robot in a ROS 2 graph. One table of endpoints, one set of bytes, three back ends.

What is not a back end's is standard library and Python 3.10, since the rclpy back end runs under the
interpreter of the ROS distribution.
"""
