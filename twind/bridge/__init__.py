"""Where twind meets other machines and the ROS 2 graph: clients of the socket, each a process of its own.

`ros`: topics and services of ROS 2 over rclpy, DDS or Zenoh · `uplink`: one robot's state out over Zenoh,
goals in · `fleet`: many robots from afar · `zenoh`: sessions and keys that the others share.
"""
