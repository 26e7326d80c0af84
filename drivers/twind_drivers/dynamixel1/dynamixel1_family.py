"""Driver family `dynamixel1`: Dynamixel servos with Protocol 1.0."""

from twind.config.driver_family import DriverFamily, FamilyPart
from twind.config.port_names import Medium
from twind_drivers.dynamixel1 import dynamixel1_keys
from twind_drivers.dynamixel1.dynamixel1_models import models
from twind_drivers.dynamixel1.dynamixel1_type import KIND

DYNAMIXEL1 = DriverFamily(
    kind=KIND,
    medium=Medium.SERIAL,
    bus_keys=dynamixel1_keys.Dynamixel1BusKeys,
    type_keys=dynamixel1_keys.Dynamixel1TypeKeys,
    slot_keys=dynamixel1_keys.Dynamixel1SlotKeys,
    read_bus=dynamixel1_keys.dynamixel1_bus,
    knows=lambda device: device in models(),
    models=models,
    read_type=dynamixel1_keys.dynamixel1_type,
    read_slot=dynamixel1_keys.dynamixel1_slot,
    budget=dynamixel1_keys.dynamixel1_budget,
    driver=FamilyPart("twind_drivers.dynamixel1.dynamixel1_bus:DRIVER"),
    virtual=FamilyPart("twind_drivers.dynamixel1.dynamixel1_twin:TWIN"),
    doctor=FamilyPart("twind_drivers.servo_tools.doctor.servo_doctor:DOCTOR"),
    scan=FamilyPart("twind_drivers.dynamixel1.dynamixel1_tools:scan"),
    adopt=FamilyPart("twind_drivers.servo_tools.adoption.adopt_command:adopt"),
    relocate=FamilyPart("twind_drivers.servo_tools.adoption.relocate_command:relocate"),
    tools=FamilyPart("twind_drivers.dynamixel1.dynamixel1_tools:TOOLS"),
    alert_register="hardware_error_status",
)
