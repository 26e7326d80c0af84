"""Driver family `can`: actuators of CubeMars, Damiao, ODrive and RobStride, which may share a bus."""

from twind.config.driver_family import DriverFamily, FamilyPart
from twind.config.port_names import Medium
from twind_drivers.can import can_keys
from twind_drivers.can.can_bus_budget import can_budget
from twind_drivers.can.can_models import MODELS
from twind_drivers.can.can_type import KIND

CAN = DriverFamily(
    kind=KIND,
    medium=Medium.CAN,
    bus_keys=can_keys.CanBusKeys,
    type_keys=can_keys.CanTypeKeys,
    slot_keys=can_keys.CanSlotKeys,
    read_bus=can_keys.can_bus,
    knows=MODELS.__contains__,
    models=MODELS.keys,
    read_type=can_keys.can_type,
    read_slot=can_keys.can_slot,
    refuse_clash=can_keys.refuse_clash,
    budget=can_budget,
    driver=FamilyPart("twind_drivers.can.can_bus:DRIVER"),
    virtual=FamilyPart("twind_drivers.can.can_twin:TWIN"),
    doctor=FamilyPart("twind_drivers.can.doctor.can_doctor:DOCTOR"),
    alert_register="hardware_error_status",
)
