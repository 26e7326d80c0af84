"""Every check of buses, servos and CAN actuators, in the order of looking."""

from collections.abc import Callable, Iterator

from twind.doctor import bus_checks, can_checks, servo_checks, supply_checks
from twind.doctor.check import DoctorFinding
from twind.doctor.check_context import CheckContext

Look = Callable[[CheckContext], Iterator[DoctorFinding]]

BUSES = "serial buses"
SERVOS = "servos"
ACTUATORS = "CAN actuators"

# what it is in a word, the codes it can find, the function
CHECKS: tuple[tuple[str, tuple[str, ...], Look], ...] = (
    (BUSES, ("BUS_SILENT", "BUS_TALK", "BUS_ECHO", "PROTOCOL_OLD", "BUS_NOISE"), bus_checks.line),
    (BUSES, ("BAUD_WRONG", "SERVO_FRESH", "SERVO_MISSING", "ID_TWICE", "SERVO_FOREIGN"), bus_checks.who),
    (BUSES, ("IMU_SILENT", "IMU_GRAVITY"), bus_checks.inertial),
    (BUSES, ("SERVO_MODEL", "WATCHDOG_UNKNOWN", "FIRMWARE_SLOW", "SECOND_ID"), bus_checks.model),
    (BUSES, ("BUS_BUDGET", "RETURN_DELAY", "SERVO_SLOW"), bus_checks.speed),
    (
        SERVOS,
        (
            *("STATUS_LEVEL", "OPERATING_MODE", "TORQUE_BY_GOAL", "TORQUE_AT_BOOT", "RAM_RESTORE"),
            *("OFFSET_IGNORED", "REVERSED", "PROFILE_IN_TIME", "REGISTER_DIFFERS"),
        ),
        servo_checks.settings,
    ),
    (SERVOS, ("CALIBRATION_CHANGED", "FIRMWARE_CHANGED"), servo_checks.calibrated),
    (
        SERVOS,
        ("FENCE_TIGHT", "LIMIT_ZERO", "CURRENT_CAP", "SHUTDOWN_MASK", "PROFILE_LEFT", "INDIRECT_LEFT"),
        servo_checks.limits,
    ),
    (SERVOS, ("VOLTAGE_LOW", "VOLTAGE_HIGH", "VOLTAGE_BOUNDS", "VOLTAGE_DROP"), supply_checks.supply),
    (
        SERVOS,
        (
            *("ERROR_OVERLOAD", "ERROR_HEAT", "ERROR_VOLTAGE", "ERROR_ENCODER", "ERROR_SHOCK"),
            *("SERVO_HOT", "TORQUE_ON", "WATCHDOG_TRIPPED", "WATCHDOG_OFF", "WATCHDOG_LEFT"),
        ),
        servo_checks.state,
    ),
    (
        ACTUATORS,
        ("CAN_SILENT", "CAN_CONTROLLER", "CAN_MASTER", "CAN_FOREIGN", "CAN_MISSING"),
        can_checks.bus,
    ),
    (
        ACTUATORS,
        ("CAN_TWICE", "CAN_RANGE", "CAN_MODE", "CAN_FAULT", "CAN_VOLTAGE_LOW"),
        can_checks.nodes,
    ),
    (ACTUATORS, ("CAN_TORQUE_ON", "CAN_WATCHDOG_OFF", "CAN_WATCHDOG_UNVERIFIED"), can_checks.torque),
)
