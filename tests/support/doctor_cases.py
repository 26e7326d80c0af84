"""Planted defects of buses, servos and CAN actuators, with the finding that each must cause."""

from tests.support.doctor_robot import case, fault

LIMP = (  # nobody has torque
    case("RETURN_DELAY", 1, (9, 250), text="500 us", mended=(9, 5)),
    case("STATUS_LEVEL", 2, (68, 1), text="is 1", mended=(68, 2)),
    case("OPERATING_MODE", 3, (11, 4), text="is 4"),
    case("TORQUE_BY_GOAL", 4, (10, 8), text="is 8"),
    case("TORQUE_AT_BOOT", 5, (60, 1), text="is 1"),
    case("TORQUE_AT_BOOT", 6, (60, 2), text="is 2"),
    case("OPERATING_MODE", 7, (20, 2000), text="is 2000"),
    case("FENCE_TIGHT", 7, (44, 0), text="velocity_limit is 0"),
    case("CALIBRATION_CHANGED", 8, (48, 4000), text="max_position_limit is 4000"),
    case("REGISTER_DIFFERS", 9, (10, 4), text="is 4: profiles are times"),
    case("SHUTDOWN_MASK", 9, (63, 17), text="overheating and overload"),
    case("REGISTER_DIFFERS", 10, (44, 150), text="velocity_limit is 150"),
    case("FENCE_TIGHT", 11, (52, 2048), text="are 2048.."),
    case("FENCE_TIGHT", 12, (38, 500), text="is 500"),
    case("SECOND_ID", 12, (12, 77), text="is 77"),
    case("WATCHDOG_LEFT", 12, (98, 5), text="is 5, 100 ms", mended=(98, 0)),
    fault("SERVO_ERROR", 3, {"fault": "damage", "id": 3, "bits": 32}, text="overload"),
    fault("SERVO_ERROR", 4, {"fault": "damage", "id": 4, "bits": 4}, text="overheating"),
    fault("SERVO_ERROR", 5, {"fault": "damage", "id": 5, "bits": 8}, text="encoder"),
    fault("SERVO_ERROR", 6, {"fault": "damage", "id": 6, "bits": 16}, text="electrical shock"),
    fault("SERVO_ERROR", 8, {"fault": "damage", "id": 8, "bits": 1}, text="input voltage"),
    fault(
        "SERVO_ERROR",
        11,
        {"fault": "heat", "id": 11, "celsius": 65},
        {"fault": "heat", "id": 11, "celsius": 25},
        "65 degC",
    ),
    fault(
        "VOLTAGE_DROP",
        10,
        {"fault": "sag", "id": 10, "volts": 1.0},
        {"fault": "sag", "id": 10, "volts": 0},
        "11.0 V",
    ),
    case("VOLTAGE_LOW", 10, text="11.0 V"),  # what the thin cable does to it
)
TIGHT = (  # torque is on
    case("TORQUE_ON", 1, (64, 1), text="torque is on; bus watchdog (98) is 0"),
    case("WATCHDOG_TRIPPED", 2, (64, 1), (98, 5), text="is 255"),
)
MENDABLE = (case("RETURN_DELAY", 1, (9, 20), text="40 us"),)  # one that could be mended
# Without a calibration, or with another one, of the same servos.
UNCALIBRATED = (case("OPERATING_MODE", 3, (10, 1), text="is 1: it is reversed"),)
OLDER = (case("CALIBRATION_CHANGED", 5, text="firmware 47"),)


LINE = (  # of one line at a time
    fault("SERVO_MISSING", 4, {"fault": "silence", "id": 4}, {"fault": "clear"}, "id 4 (l_shoulder_roll)"),
    fault("BUS_SILENT", 0, {"fault": "silence"}, {"fault": "clear"}, "no answer at any baud rate"),
    fault("BUS_NOISE", 0, {"fault": "echo", "on": True}, {"fault": "clear"}, "comes back before its reply"),
    fault("BUS_TALK", 0, {"fault": "babble", "on": True}, {"fault": "clear"}),
    fault(
        "BUS_NOISE",
        0,
        {"fault": "bit_errors", "rate": 1e-3, "to_servos": False},
        {"fault": "clear"},
        "garbled",
    ),
    fault(
        "BUS_NOISE",
        7,
        {"fault": "delay", "seconds": 0.003, "id": 7},
        {"fault": "clear"},
        "id 7 (r_shoulder_pitch)",
    ),
    fault(
        "VOLTAGE_HIGH", 0, {"fault": "supply", "volts": 15.5}, {"fault": "supply", "volts": 12.0}, "15.5 V"
    ),
)
# A bus on which much is odd: who is there, and what that makes of a robot of twelve XM430.
ODD = ("2:XM430-W350:36", "3:XL330-M288:52", "4:XM430-W350", "4:XM430-W350", "5:XM430-W350", "6:XM430-W350")
ODD += ("9:XM430-W350", "27:XM430-W350")
STRANGE = (
    case("WATCHDOG_UNKNOWN", 2, text="firmware 36"),
    case("SERVO_MODEL", 3, text="a XL330-M288"),
    case("ID_TWICE", 4),
    case("SERVO_FOREIGN", 27, text="a XM430-W350 answers"),
    case("BAUD_WRONG", 1, text="the factory's id and rate"),
    case("BUS_BUDGET", 0, text="ids without fast read: 2 (firmware 36)"),
)
AWAY = (case("BAUD_WRONG", 0, text="ids 5 (of this robot) answer at 1000000 baud"),)
LEGS = (  # of the nodes of a CAN bus, all at once: Damiao on l_leg, RobStride on r_leg
    case("REGISTER_DIFFERS", 1, text="position_range is 25 rad"),
    case("REGISTER_DIFFERS", 2, text="mode is 3"),
    case("SERVO_ERROR", 3, text="electrical shock"),
    case("TORQUE_ON", 4, text="torque is on; timeout is 0, off"),
    case("SERVO_MISSING", 5, text="no answer"),
    case("WATCHDOG_UNKNOWN", 0, text="unverified", times=2),
    case("VOLTAGE_LOW", 0, text="19.0 V", times=2),
)
WIRES = (  # of one CAN line at a time
    fault("ID_TWICE", 6, {"fault": "twin", "id": 6, "on": True}, {"fault": "clear"}),
    fault(
        "SERVO_FOREIGN", 0, {"fault": "foreign", "count": 1000}, {"fault": "clear"}, "frames of unknown ids"
    ),
    fault(
        "BUS_TALK",
        0,
        {"fault": "master", "id": 6, "on": True},
        {"fault": "clear"},
        "commands of another master",
    ),
    fault("BUS_NOISE", 0, {"fault": "passive", "on": True}, {"fault": "clear"}, "error passive"),
    fault("BUS_SILENT", 0, {"fault": "silence"}, {"fault": "clear"}, "none of 6 actuators answers"),
)
