"""Driver family `dynamixel2`: serial servos of Dynamixel protocol 2.0."""

from twind.config.driver_family import DriverFamily, FamilyPart
from twind.config.port_names import Medium
from twind_drivers.dynamixel import servo_keys
from twind_drivers.dynamixel.servo_bus_budget import servo_budget
from twind_drivers.dynamixel.servo_type import KIND

DYNAMIXEL = DriverFamily(
    kind=KIND,
    medium=Medium.SERIAL,
    bus_keys=servo_keys.SerialBusKeys,
    type_keys=servo_keys.ServoTypeKeys,
    slot_keys=servo_keys.ServoSlotKeys,
    read_bus=servo_keys.servo_bus,
    knows=servo_keys.is_servo,
    models=servo_keys.driven_models,
    read_type=servo_keys.servo_type,
    read_slot=servo_keys.servo_slot,
    budget=servo_budget,
    driver=FamilyPart("twind_drivers.dynamixel.dynamixel_bus:DRIVER"),
    virtual=FamilyPart("twind_drivers.dynamixel.servo_twin:TWIN"),
    doctor=FamilyPart("twind_drivers.servo_tools.doctor.servo_doctor:DOCTOR"),
    scan=FamilyPart("twind_drivers.dynamixel.dynamixel_tools:scan"),
    adopt=FamilyPart("twind_drivers.servo_tools.adoption.adopt_command:adopt"),
    relocate=FamilyPart("twind_drivers.servo_tools.adoption.relocate_command:relocate"),
    tools=FamilyPart("twind_drivers.dynamixel.dynamixel_tools:TOOLS"),
    takes_imu=True,
    alert_register="hardware_error_status",
)
