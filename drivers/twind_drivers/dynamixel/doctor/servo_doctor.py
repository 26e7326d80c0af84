"""Doctor of serial servos: its subjects in the order of the checks."""

from twind.doctor.family_doctor import FamilyDoctor
from twind_drivers.dynamixel.doctor import serial_bus, servo_settings, servo_state
from twind_drivers.dynamixel.doctor.serial_bus import BUSES
from twind_drivers.dynamixel.doctor.serial_bus_inspector import inspector, reading_time
from twind_drivers.dynamixel.doctor.servo_settings import SERVOS

DOCTOR = FamilyDoctor((serial_bus, servo_settings, servo_state), inspector, (BUSES, SERVOS), reading_time)
