"""The complaints about ports: serial adapters and CAN interfaces of this machine."""

from twind_calibration.doctor.cautions import OTHER_MASTER, OURS, SUPPORT, UNPLUGGED
from twind_calibration.doctor.complaint import Complaint, Severity

FAULT, WARNING, NOTE = Severity.FAULT, Severity.WARNING, Severity.NOTE

SERIAL = (
    Complaint(
        "PORT_UNSET",
        "a bus has no port",
        "`mirror` stays disconnected and `live` is refused",
        "`ports: {BUS: /dev/serial/by-id/…}` in the settings, or `--port BUS=PORT`",
        NOTE,
        caution=OURS,
    ),
    Complaint(
        "PORT_MISSING",
        "the port does not exist",
        "the robot is not connected; the daemon waits for it",
        "plug it in; if it has another name now, use the one that stays: `ls -l /dev/serial/by-id/`",
        FAULT,
        caution=UNPLUGGED,
    ),
    Complaint(
        "PORT_UNFIT",
        "the port is no serial port",
        "the daemon does not start with it",
        "give a serial port: `ls -l /dev/serial/by-id/`",
        FAULT,
    ),
    Complaint(
        "PORT_RENUMBERED",
        "the port's name changes when it is plugged in again",
        "after a replug another adapter, or none, may have this number: the wrong bus would be driven",
        "write the name that stays into the settings: `ls -l /dev/serial/by-id/`",
        NOTE,
    ),
    Complaint(
        "PORT_DENIED",
        "the user of the daemon may not open the port",
        "the daemon cannot reach the robot",
        "`sudo usermod -aG dialout USER`, then log in again; not `chmod 666`, not sudo",
        FAULT,
    ),
    Complaint(
        "PORT_HELD",
        "another program has the port",
        "two talkers on one bus destroy each other's packets; the daemon refuses to start, or hears garbage",
        "end the program that it names by its own command; another twind is asked by `twindctl "
        "--socket DIR`, or stopped",
        FAULT,
        caution=OTHER_MASTER,
        explains=("UNIT_FAILED", "NO_DAEMON"),
    ),
    Complaint(
        "PORT_PROBED",
        "ModemManager may take the port for a modem",
        "it writes to every new serial port: bytes on the bus that nobody asked for",
        "install twind's udev rules (`sudo make install`), or `sudo systemctl mask --now ModemManager`",
        WARNING,
        caution="where this machine reaches its network by a modem, take the udev rules: without "
        "ModemManager it is cut off",
        explains=("PORT_HELD",),
    ),
    Complaint(
        "LATENCY_TIMER",
        "the adapter's latency timer is long",
        "each answer waits up to that long in the adapter: 16 ms allow 50 to 60 readings a second at best",
        "`echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB0/latency_timer`; "
        "for good, twind's udev rules (`sudo make install`)",
        WARNING,
        explains=("LATENCY_FLOOR",),
    ),
    Complaint(
        "LATENCY_FLOOR",
        "answers come as late as a latency timer would make them",
        "readings are old and fewer than asked for; the gate refuses to write above 100 ms",
        "set the timer as in LATENCY_TIMER, by sysfs, not by `setserial`; no hub or virtual "
        "machine between; "
        "another adapter",
        WARNING,
        caution=UNPLUGGED,
    ),
    Complaint(
        "USB_AUTOSUSPEND",
        "the adapter may be put to sleep",
        "the first packet after a pause waits for it to wake, or is lost",
        "`echo on | sudo tee /sys/bus/usb/devices/DEVICE/power/control`; for good, twind's udev rules",
        WARNING,
    ),
    Complaint(
        "USB_HUBS",
        "the adapter hangs behind several hubs, or shares a slow one",
        "every hub adds delay and a connector, and its other devices share the wire",
        "plug the adapter into the computer itself",
        NOTE,
        caution=UNPLUGGED,
    ),
    Complaint(
        "BAUD_UNSUPPORTED",
        "the adapter cannot do this baud rate",
        "all servos are silent, or answer garbage",
        "another adapter (FT232H: 12 Mbaud), or a lower `baud` in the robot file and in the servos",
        FAULT,
        caution=UNPLUGGED,
    ),
)

CAN = (
    Complaint(
        "CAN_LINK_MISSING",
        "there is no such CAN interface",
        "the bus is not connected",
        "plug the adapter in, `sudo modprobe can_raw`, "
        "then `sudo ip link set can0 up type can bitrate 1000000 restart-ms 100`",
        FAULT,
        caution="make sure which rate the actuators have: an interface with another one destroys "
        "the frames of all devices",
    ),
    Complaint(
        "CAN_LINK_DOWN",
        "the CAN interface is down",
        "nothing is sent or heard on that bus",
        "`sudo ip link set can0 up type can bitrate 1000000 restart-ms 100`",
        FAULT,
        caution="make sure which rate the actuators have: an interface with another one destroys "
        "the frames of all devices",
    ),
    Complaint(
        "CAN_LINK_BITRATE",
        "the CAN interface has another bit rate than the robot file",
        "no frame is understood, and an interface with a wrong rate destroys those of the others",
        "`twindctl disarm`, for who is armed loses the bus; then `sudo ip link set can0 down`, and "
        "`sudo ip link set can0 up type can bitrate RATE`",
        FAULT,
        caution="make sure which rate the actuators have: an interface with another one destroys "
        f"the frames of all devices; {SUPPORT}",
        explains=("CAN_LINK_STATE",),
    ),
    Complaint(
        "CAN_LINK_STATE",
        "the CAN controller has left the bus, or is about to",
        "nobody acknowledges: power of the actuators, termination, wiring or bit rate",
        "power of the actuators; 60 Ω between the wires with everything off; the bit rate; "
        "then `twindctl disarm`, `sudo ip link set can0 down` and `up`",
        FAULT,
        caution=SUPPORT,
        explains=("CAN_LINK_ERRORS",),
    ),
    Complaint(
        "CAN_LINK_ERRORS",
        "the CAN controller counts errors",
        "frames are broken and repeated: the bus still works, but late, and it may get worse",
        "60 Ω between the wires with everything off; plugs, shield, bit rate; counters fall by themselves",
        WARNING,
        caution=UNPLUGGED,
    ),
    Complaint(
        "CAN_LINK_QUEUE",
        "the queue of the CAN interface is long",
        "while nobody acknowledges it keeps old commands; when power returns they go out: the robot snaps",
        "`sudo ip link set can0 txqueuelen 48`",
        WARNING,
    ),
    Complaint(
        "CAN_LINK_RESTART",
        "the CAN controller does not come back by itself",
        "after one bus-off the bus stays dead until a person takes the interface down and up",
        "`twindctl disarm`, then `sudo ip link set can0 down`, "
        "then `sudo ip link set can0 up type can bitrate RATE restart-ms 100`",
        WARNING,
        caution=SUPPORT,
    ),
)

PORTS: tuple[Complaint, ...] = (*SERIAL, *CAN)
