"""CAN bus of the loop: reader, writer, and the description of an actuator."""

from twind_drivers.can.actuator import CanActuatorIdentity
from twind_drivers.can.can_reader import CanReader
from twind_drivers.can.can_writer import CanWriter

__all__ = ["CanActuatorIdentity", "CanReader", "CanWriter"]
