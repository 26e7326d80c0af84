"""Driver family `feetech`: serial servos STS, SMS, SCS and HLS."""

from twind.config.driver_family import DriverFamily, FamilyPart
from twind.config.port_names import Medium
from twind_drivers.feetech import feetech_keys
from twind_drivers.feetech.feetech_models import models
from twind_drivers.feetech.feetech_type import KIND

FEETECH = DriverFamily(
    kind=KIND,
    medium=Medium.SERIAL,
    bus_keys=feetech_keys.FeetechBusKeys,
    type_keys=feetech_keys.FeetechTypeKeys,
    slot_keys=feetech_keys.FeetechSlotKeys,
    read_bus=feetech_keys.feetech_bus,
    knows=lambda device: device in models(),
    models=models,
    read_type=feetech_keys.feetech_type,
    read_slot=feetech_keys.feetech_slot,
    budget=feetech_keys.feetech_budget,
    driver=FamilyPart("twind_drivers.feetech.feetech_bus:DRIVER"),
    virtual=FamilyPart("twind_drivers.feetech.feetech_twin:TWIN"),
    doctor=FamilyPart("twind_drivers.servo_tools.doctor.servo_doctor:DOCTOR"),
    scan=FamilyPart("twind_drivers.feetech.feetech_tools:scan"),
    adopt=FamilyPart("twind_drivers.servo_tools.adoption.adopt_command:adopt"),
    relocate=FamilyPart("twind_drivers.servo_tools.adoption.relocate_command:relocate"),
    tools=FamilyPart("twind_drivers.feetech.feetech_tools:TOOLS"),
    alert_register="hardware_error_status",
)
