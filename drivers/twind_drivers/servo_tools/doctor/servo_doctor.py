"""Doctor of serial servos: its subjects in the order of the checks."""

from twind.doctor.family_doctor import FamilyDoctor
from twind_drivers.servo_tools.doctor import serial_bus, servo_settings, servo_state
from twind_drivers.servo_tools.doctor.serial_bus import BUSES
from twind_drivers.servo_tools.doctor.serial_bus_inspector import inspector, reading_time
from twind_drivers.servo_tools.doctor.servo_settings import SERVOS

DOCTOR = FamilyDoctor((serial_bus, servo_settings, servo_state), inspector, (BUSES, SERVOS), reading_time)
