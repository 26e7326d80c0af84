"""Doctor of CAN actuators: its subjects in the order of the checks."""

from twind.doctor.family_doctor import FamilyDoctor
from twind_drivers.can.doctor import can_bus_checks
from twind_drivers.can.doctor.can_bus_checks import ACTUATORS
from twind_drivers.can.doctor.can_bus_inspector import inspector

DOCTOR = FamilyDoctor((can_bus_checks,), inspector, (ACTUATORS,))
