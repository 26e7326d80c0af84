"""ROS 2 over DDS, by Cyclone DDS: `DdsTransport` is a `twind.bridge.ros.ros_transport.RosTransport`."""

from twind.bridge.ros.dds.dds_transport import DdsTransport

__all__ = ["DdsTransport"]
