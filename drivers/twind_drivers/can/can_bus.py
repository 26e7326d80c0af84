"""The CAN bus as the loop sees it: a reader, a writer, and how an actuator is described."""

from twind_drivers.can.actuator import CanActuator
from twind_drivers.can.can_reader import CanReader
from twind_drivers.can.can_writer import CanWriter

__all__ = ["CanActuator", "CanReader", "CanWriter"]
