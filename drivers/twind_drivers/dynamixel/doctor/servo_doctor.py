"""Doctor of serial servos: its subjects in the order of the checks."""

from twind.doctor.family_doctor import FamilyDoctor
from twind_drivers.dynamixel.doctor import serial_bus, servo_settings, servo_state
from twind_drivers.dynamixel.doctor.serial_bus_inspector import inspector, reading_time

DOCTOR = FamilyDoctor((serial_bus, servo_settings, servo_state), inspector, reading_time)
