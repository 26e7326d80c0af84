"""Every check of the machine, the files and the daemon, in the order of looking."""

from collections.abc import Callable, Iterator

from twind_calibration.doctor import can_links, files, latency, machine, ports, service, storage
from twind_calibration.doctor.complaint import DoctorFinding
from twind_calibration.doctor.examined import CheckContext

Look = Callable[[CheckContext], Iterator[DoctorFinding]]

# what it is in a word, the codes it can find, the function
CHECKS: tuple[tuple[str, tuple[str, ...], Look], ...] = (
    ("files", ("FILE_REFUSED", "CALIBRATION_UNFIT"), files.refused),
    ("model", ("MODEL_UNFIT", "MODEL_NO_LIMITS"), files.model),
    ("calibration", ("CALIBRATION_MISSING",), files.calibration),
    ("service", ("UNIT_FAILED", "UNIT_RESTARTED"), service.unit),
    ("daemon", ("DAEMON_DENIED", "DAEMON_SILENT", "NO_DAEMON"), service.reach),
    ("sockets", ("SOCKET_GROUP", "SOCKET_OPEN"), service.sockets),
    ("versions", ("VERSION_DIFFERS",), service.versions),
    ("files as read", ("FILES_EDITED",), files.edited),
    ("front", ("FRONT_RESTARTED",), service.front),
    ("ports", ("PORT_UNSET",), ports.unset),
    ("ports", ("PORT_MISSING", "PORT_UNFIT", "PORT_RENUMBERED"), ports.present),
    ("rights", ("PORT_DENIED",), ports.permitted),
    ("holders", ("PORT_HELD",), ports.free),
    ("probing programs", ("PORT_PROBED",), ports.probed),
    ("latency timers", ("LATENCY_TIMER",), ports.timers),
    ("USB", ("USB_AUTOSUSPEND", "USB_HUBS"), ports.usb),
    ("baud rates", ("BAUD_UNSUPPORTED",), ports.rates),
    ("latency", ("LATENCY_FLOOR",), latency.floors),
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
    ("real time", ("NO_REALTIME", "MEMORY_UNLOCKED"), machine.realtime),
    ("ticks", ("TICKS_MISSED",), service.ticks),
    ("processors", ("CPU_FEW", "CPU_GOVERNOR"), machine.processors),
    ("other real-time programs", ("RT_RIVAL",), machine.rivals),
    ("clock", ("CLOCK_WRONG", "CLOCK_UNSYNCED"), machine.clock),
    ("state folder", ("STATE_UNWRITABLE",), storage.writable),
    ("disks", ("DISK_FULL",), storage.disks),
    ("software", ("SOFTWARE_OLD",), storage.software),
)
# What comes last: the daemon's own words are about what the others have found, if they have.
AFTER: tuple[tuple[str, tuple[str, ...], Look], ...] = (("arming", ("DAEMON_FAULT",), service.faults),)
