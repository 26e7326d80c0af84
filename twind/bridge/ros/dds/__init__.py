"""ROS 2 over DDS, by Cyclone DDS: `Dds` is a `twind.bridge.ros.transport.RosTransport`."""

from twind.bridge.ros.dds.transport import DdsTransport

__all__ = ["DdsTransport"]
