"""Every check of the machine, the files and the daemon, in the order of looking."""

from collections.abc import Callable, Iterator

from twind.doctor import (
    can_links,
    file_checks,
    latency_test,
    machine_checks,
    port_checks,
    service_checks,
    storage_checks,
)
from twind.doctor.check import DoctorFinding
from twind.doctor.check_context import CheckContext

Look = Callable[[CheckContext], Iterator[DoctorFinding]]

# what it is in a word, the codes it can find, the function
CHECKS: tuple[tuple[str, tuple[str, ...], Look], ...] = (
    ("files", ("FILE_REFUSED", "CALIBRATION_UNFIT"), file_checks.check_file_refused),
    ("model", ("MODEL_UNFIT", "MODEL_NO_LIMITS"), file_checks.model),
    ("calibration", ("CALIBRATION_MISSING",), file_checks.calibration),
    ("service", ("UNIT_FAILED", "UNIT_RESTARTED"), service_checks.unit),
    ("daemon", ("DAEMON_DENIED", "DAEMON_SILENT", "NO_DAEMON"), service_checks.reach),
    ("sockets", ("SOCKET_GROUP", "SOCKET_OPEN"), service_checks.sockets),
    ("versions", ("VERSION_DIFFERS",), service_checks.versions),
    ("files as read", ("FILES_EDITED",), file_checks.edited),
    ("front", ("FRONT_RESTARTED",), service_checks.front),
    ("ports", ("PORT_UNSET",), port_checks.unset),
    ("ports", ("PORT_MISSING", "PORT_UNFIT", "PORT_RENUMBERED"), port_checks.present),
    ("rights", ("PORT_DENIED",), port_checks.permitted),
    ("holders", ("PORT_HELD",), port_checks.check_port_held),
    ("probing programs", ("PORT_PROBED",), port_checks.probed),
    ("latency timers", ("LATENCY_TIMER",), port_checks.timers),
    ("USB", ("USB_AUTOSUSPEND", "USB_HUBS"), port_checks.usb),
    ("baud rates", ("BAUD_UNSUPPORTED",), port_checks.rates),
    ("latency", ("LATENCY_FLOOR",), latency_test.floors),
    (
        "CAN interfaces",
        (
            "CAN_LINK_MISSING",
            "CAN_LINK_BITRATE",
            "CAN_LINK_DOWN",
            "CAN_LINK_STATE",
            "CAN_LINK_ERRORS",
            "CAN_LINK_QUEUE",
            "CAN_LINK_RESTART",
        ),
        can_links.links,
    ),
    ("real time", ("NO_REALTIME", "MEMORY_UNLOCKED"), machine_checks.realtime),
    ("ticks", ("TICKS_MISSED",), service_checks.ticks),
    ("processors", ("CPU_FEW", "CPU_GOVERNOR"), machine_checks.processors),
    ("other real-time programs", ("RT_RIVAL",), machine_checks.rivals),
    ("clock", ("CLOCK_WRONG", "CLOCK_UNSYNCED"), machine_checks.clock),
    ("state folder", ("STATE_UNWRITABLE",), storage_checks.writable),
    ("disks", ("DISK_FULL",), storage_checks.disks),
    ("software", ("SOFTWARE_OLD",), storage_checks.software),
)
# What comes last: the daemon's own words are about what the others have found, if they have.
AFTER: tuple[tuple[str, tuple[str, ...], Look], ...] = (("arming", ("DAEMON_FAULT",), service_checks.faults),)
