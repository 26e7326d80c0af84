"""The complaints about ports: serial adapters and CAN interfaces of this machine."""

from twind.doctor.cautions import BIT_RATE, OTHER_MASTER, OURS, SUPPORT, UNPLUGGED
from twind.doctor.check import Check, Severity

FAULT = Severity.FAULT
WARNING = Severity.WARNING
NOTE = Severity.NOTE

SERIAL = (
    Check(
        "PORT_UNSET",
        "a bus has no port",
        "`mirror` stays disconnected and `live` is refused",
        "`ports: {BUS: /dev/serial/by-id/…}` in the settings, or `--port BUS=PORT`",
        NOTE,
        caution=OURS,
    ),
    Check(
        "PORT_MISSING",
        "the port does not exist",
        "the robot is not connected; the daemon waits",
        "plug it in, or use its permanent name: `ls -l /dev/serial/by-id/`",
        FAULT,
        caution=UNPLUGGED,
    ),
    Check(
        "PORT_UNFIT",
        "the port is not a serial port",
        "the daemon does not start",
        "give a serial port: `ls -l /dev/serial/by-id/`",
        FAULT,
    ),
    Check(
        "PORT_RENUMBERED",
        "the port name changes after a replug",
        "the daemon may open another adapter and drive the wrong bus",
        "put the permanent name into the settings: `ls -l /dev/serial/by-id/`",
        NOTE,
    ),
    Check(
        "PORT_DENIED",
        "the daemon's user may not open the port",
        "the daemon cannot reach the robot",
        "`sudo usermod -aG dialout USER`, then log in again; not `chmod 666`, not sudo",
        FAULT,
    ),
    Check(
        "PORT_HELD",
        "another program has the port",
        "two masters corrupt each other's packets; the daemon does not start",
        "end that program by its own command; another twind: `twindctl --socket DIR`, or stop it",
        FAULT,
        caution=OTHER_MASTER,
        explains=("UNIT_FAILED", "NO_DAEMON"),
    ),
    Check(
        "PORT_PROBED",
        "ModemManager may probe the port as a modem",
        "it writes unexpected bytes to every new serial port",
        ("install twind's udev rules (`sudo make install`), or `sudo systemctl mask --now ModemManager`"),
        WARNING,
        caution="without ModemManager a modem network fails: use the udev rules there",
        explains=("PORT_HELD",),
    ),
    Check(
        "LATENCY_TIMER",
        "the adapter's latency timer is long",
        "16 ms allow at most 50 to 60 readings per second",
        (
            "`echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB0/latency_timer`; permanently: twind's "
            "udev rules (`sudo make install`)"
        ),
        WARNING,
        explains=("LATENCY_FLOOR",),
    ),
    Check(
        "LATENCY_FLOOR",
        "answers are as late as with a long latency timer",
        "readings are old and few; above 100 ms motion is refused",
        (
            "set the timer (LATENCY_TIMER) by sysfs, not `setserial`; no hub or virtual machine; another "
            "adapter"
        ),
        WARNING,
        caution=UNPLUGGED,
    ),
    Check(
        "USB_AUTOSUSPEND",
        "the adapter may be suspended",
        "the first packet after a pause is delayed or lost",
        ("`echo on | sudo tee /sys/bus/usb/devices/DEVICE/power/control`; permanently: twind's udev rules"),
        WARNING,
    ),
    Check(
        "USB_HUBS",
        "the adapter is behind several hubs or a slow one",
        "each hub adds delay and a connector; devices share bandwidth",
        "plug the adapter into the computer",
        NOTE,
        caution=UNPLUGGED,
    ),
    Check(
        "BAUD_UNSUPPORTED",
        "the adapter does not support this baud rate",
        "servos are silent or answers are corrupt",
        "another adapter (FT232H: 12 Mbaud), or a lower `baud` in robot file and servos",
        FAULT,
        caution=UNPLUGGED,
    ),
)

CAN = (
    Check(
        "CAN_LINK_MISSING",
        "the CAN interface does not exist",
        "the bus is not connected",
        (
            "plug the adapter in, `sudo modprobe can_raw`, `sudo ip link set can0 up type can bitrate "
            "1000000 restart-ms 100`"
        ),
        FAULT,
        caution=BIT_RATE,
    ),
    Check(
        "CAN_LINK_DOWN",
        "the CAN interface is down",
        "the bus carries no frames",
        "`sudo ip link set can0 up type can bitrate 1000000 restart-ms 100`",
        FAULT,
        caution=BIT_RATE,
    ),
    Check(
        "CAN_LINK_BITRATE",
        "CAN interface and robot file differ in bit rate",
        "no frame is received; a wrong rate destroys the frames of others",
        (
            "`twindctl disarm` (the bus is lost), `sudo ip link set can0 down`, `sudo ip link set can0 up "
            "type can bitrate RATE`"
        ),
        FAULT,
        caution=f"{BIT_RATE}; {SUPPORT}",
        explains=("CAN_LINK_STATE",),
    ),
    Check(
        "CAN_LINK_STATE",
        "the CAN controller left the bus or soon will",
        "frames get no acknowledgement: power, termination, wiring or bit rate",
        (
            "check power, bit rate, 60 Ω between the wires (all off); `twindctl disarm`, `sudo ip link "
            "set can0 down`, `up`"
        ),
        FAULT,
        caution=SUPPORT,
        explains=("CAN_LINK_ERRORS",),
    ),
    Check(
        "CAN_LINK_ERRORS",
        "the CAN controller counts errors",
        "frames are corrupt and repeated: slow, and possibly worse soon",
        ("60 Ω between the wires (all off); plugs, shield, bit rate; the counters decrease by themselves"),
        WARNING,
        caution=UNPLUGGED,
    ),
    Check(
        "CAN_LINK_QUEUE",
        "the queue of the CAN interface is long",
        "old commands wait and leave when power returns: the robot jerks",
        "`sudo ip link set can0 txqueuelen 48`",
        WARNING,
    ),
    Check(
        "CAN_LINK_RESTART",
        "the CAN controller does not restart by itself",
        "after bus-off the bus stays dead until a manual restart",
        (
            "`twindctl disarm`, `sudo ip link set can0 down`, `sudo ip link set can0 up type can bitrate "
            "RATE restart-ms 100`"
        ),
        WARNING,
        caution=SUPPORT,
    ),
)

PORTS: tuple[Check, ...] = (*SERIAL, *CAN)
