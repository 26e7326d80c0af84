"""A Dynamixel bus by its two halves: what reads (mirror and live) and what writes (live only)."""

from twind_drivers.dynamixel.reader import DynamixelReader
from twind_drivers.dynamixel.servo import RawGains
from twind_drivers.dynamixel.writer import DynamixelWriter

__all__ = ["DynamixelReader", "DynamixelWriter", "RawGains"]
