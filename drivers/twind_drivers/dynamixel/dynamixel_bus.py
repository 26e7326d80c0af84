"""A Dynamixel bus by its two halves: what reads (mirror and live) and what writes (live only)."""

from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.dynamixel_writer import DynamixelWriter
from twind_drivers.dynamixel.servo_command_state import RawGains

__all__ = ["DynamixelReader", "DynamixelWriter", "RawGains"]
