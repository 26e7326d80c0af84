"""Bridges to other machines and to the ROS 2 graph: clients of the socket, each a separate process.

`ros`: topics and services of ROS 2 over rclpy, DDS or Zenoh · `uplink`: one robot's state out over Zenoh,
goals in · `fleet`: many remote robots · `zenoh`: sessions and keys that the others share.
"""
