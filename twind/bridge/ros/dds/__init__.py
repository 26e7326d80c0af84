"""ROS 2 over DDS, by Cyclone DDS: `Dds` is a `twind.bridge.ros.transport.Transport`."""

from twind.bridge.ros.dds.transport import Dds

__all__ = ["Dds"]
