"""Dynamixel bus in its two halves: reader (mirror and live) and writer (live only)."""

from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.dynamixel_writer import DynamixelWriter
from twind_drivers.dynamixel.servo_command_settings import RawGains

__all__ = ["DynamixelReader", "DynamixelWriter", "RawGains"]
