"""Driver family `dynamixel2_unwatched`: servos of Protocol 2.0 without a bus watchdog."""

from twind.config.driver_family import DriverFamily, FamilyPart
from twind.config.port_names import Medium
from twind_drivers.dynamixel.servo_keys import SerialBusKeys, ServoSlotKeys
from twind_drivers.dynamixel2_unwatched import unwatched_keys
from twind_drivers.dynamixel2_unwatched.unwatched_budget import unwatched_budget
from twind_drivers.dynamixel2_unwatched.unwatched_models import models
from twind_drivers.dynamixel2_unwatched.unwatched_servo_type import KIND

DYNAMIXEL2_UNWATCHED = DriverFamily(
    kind=KIND,
    medium=Medium.SERIAL,
    bus_keys=SerialBusKeys,
    type_keys=unwatched_keys.UnwatchedServoTypeKeys,
    slot_keys=ServoSlotKeys,
    read_bus=unwatched_keys.unwatched_bus,
    knows=unwatched_keys.is_unwatched,
    models=models,
    read_type=unwatched_keys.unwatched_servo_type,
    read_slot=unwatched_keys.unwatched_slot,
    budget=unwatched_budget,
    refuse_clash=unwatched_keys.refuse_other_table,
    driver=FamilyPart("twind_drivers.dynamixel2_unwatched.unwatched_bus:DRIVER"),
    virtual=FamilyPart("twind_drivers.dynamixel2_unwatched.unwatched_twin:TWIN"),
    alert_register="hardware_error_status",
)
