"""Reader and writer of a Feetech bus."""

from twind_drivers.feetech.feetech_reader import FeetechReader
from twind_drivers.feetech.feetech_writer import FeetechWriter

__all__ = ["FeetechReader", "FeetechWriter"]
