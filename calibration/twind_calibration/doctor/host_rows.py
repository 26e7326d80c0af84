"""The complaints about machine, files and daemon: rows of the doctor's table, in order of cause."""

from twind_calibration.doctor.cautions import SUPPORT
from twind_calibration.doctor.complaint import Complaint, Severity
from twind_calibration.doctor.machine_rows import MACHINE
from twind_calibration.doctor.port_rows import PORTS

FAULT, WARNING, NOTE = Severity.FAULT, Severity.WARNING, Severity.NOTE

FILES = (
    Complaint(
        "FILE_REFUSED",
        "a file of the robot cannot be used",
        "the daemon does not start with it, and a reload is refused",
        "correct what the line says; it names file, line and column, and the nearest key that exists",
        FAULT,
        explains=("UNIT_FAILED", "NO_DAEMON"),
    ),
    Complaint(
        "MODEL_UNFIT",
        "robot file and MuJoCo model do not go together",
        "the daemon does not start: it would not know which joint of the model a servo moves",
        "correct the robot file or the model as the message says; `twindctl check robot FILE` tells more",
        FAULT,
        explains=("UNIT_FAILED", "NO_DAEMON"),
    ),
    Complaint(
        "MODEL_NO_LIMITS",
        "joints of the model have no range",
        "the limits of the robot file are the only fence: a slip there is checked against nothing",
        'write `range="LOWER UPPER"` at these joints of the model, as the mechanics allow',
        WARNING,
        caution="a range that is too wide lets the joint run into its stop: with torque off, move "
        "it by hand over the range first",
    ),
    Complaint(
        "CALIBRATION_MISSING",
        "this robot has no calibration",
        "`live` is refused: where a joint's zero is, nobody knows; `mirror` shows a guess",
        "see calibration/README.md; a file elsewhere is named with `--calibration FILE`",
        WARNING,
    ),
    Complaint(
        "CALIBRATION_UNFIT",
        "the calibration is another robot's, or was edited",
        "its zeros would move this robot to wrong places, so the daemon refuses the file",
        "put the file of this robot back, or calibrate again; "
        "its path is STATE/calibration/NAME.yaml, NAME as in `individual:` of the settings, else the robot",
        FAULT,
        caution="zeros of another robot move this one to wrong places: compare with the monitor, "
        "in mirror, before you arm",
        explains=("UNIT_FAILED", "NO_DAEMON"),
    ),
    Complaint(
        "FILES_EDITED",
        "a file was changed since the daemon read it",
        "the daemon moves the robot by the old file, and refuses to arm until it has read the new one",
        "`twindctl reload`, or disarm and `sudo systemctl restart twind`",
        WARNING,
        caution=SUPPORT,
    ),
)

DAEMON = (
    Complaint(
        "UNIT_FAILED",
        "the service failed, or the service manager has given it up",
        "no daemon runs; after 5 starts in 30 s it is not started again by itself",
        "mend what its last lines say, then `sudo systemctl reset-failed twind` "
        "and `sudo systemctl start twind`",
        FAULT,
        caution="servos may have kept their torque: support the robot before you start the daemon and disarm",
        explains=("NO_DAEMON",),
    ),
    Complaint(
        "UNIT_RESTARTED",
        "the service was restarted by the service manager",
        "the daemon crashed or hung; each time the robot was left to its servos' own watchdogs",
        "`journalctl -u twind` says why it ended",
        WARNING,
    ),
    Complaint(
        "DAEMON_DENIED",
        "a daemon runs, but this user may not talk to it",
        "every `twindctl` of this user fails; only the group of a socket may use it",
        "`sudo usermod -aG twind-operator $USER`, then log in again (`newgrp twind-operator` for this "
        "shell); one that root started by hand is root's alone: use the service",
        FAULT,
        caution="members of that group may arm and move the robot; a daemon that is ended lowers "
        "it: support it",
        explains=("NO_DAEMON", "PORT_HELD"),
    ),
    Complaint(
        "DAEMON_SILENT",
        "the daemon takes the connection but does not answer",
        "nobody can command or watch; an e-stop by this socket does not arrive either",
        "ask once more, a busy machine answers late; if it stays so, `sudo systemctl restart "
        "twind`; where the robot must "
        "stop at once, use its emergency switch; keep `journalctl -u twind` for us",
        FAULT,
        caution="support the robot: a restart or a cut of power lowers or drops it, and a loop "
        "that hangs leaves its torque on",
        explains=("PORT_HELD",),
    ),
    Complaint(
        "NO_DAEMON",
        "no daemon runs",
        "nothing reads or moves this robot now; what follows was looked up without one",
        "`twind`, or `sudo systemctl start twind`; one with other sockets is named with `--socket DIR`",
        NOTE,
    ),
    Complaint(
        "SOCKET_GROUP",
        "a socket belongs to another group than it should",
        "members of twind-operator (or twind-observe) cannot use it, or others can",
        "`sudo groupadd -rf twind-operator`, then `sudo chgrp twind-operator /run/twind/control.sock`; "
        "for good, install sysusers.d and start the daemon as its service",
        WARNING,
        caution="members of that group may arm and move the robot: check its members",
        explains=("DAEMON_DENIED",),
    ),
    Complaint(
        "SOCKET_OPEN",
        "everybody on this machine may command the robot",
        "any program of any user can arm and move it",
        "`sudo chmod 0660 /run/twind/control.sock`; the folder must not be writable by others: "
        "`sudo chmod go-w /run/twind`",
        FAULT,
        caution="a program of another user that stops the robot loses its way to it: put that user "
        "into the group first",
    ),
    Complaint(
        "VERSION_DIFFERS",
        "daemon and twindctl are of different versions",
        "the daemon still runs what was installed before; what one knows the other may not",
        "disarm, then `sudo systemctl restart twind`; if that does not help, `which -a twind twindctl`",
        WARNING,
        caution=SUPPORT,
    ),
    Complaint(
        "FRONT_RESTARTED",
        "the daemon's front was started anew",
        "at that moment leases lapsed and motion held; the front died or did not answer for 2 s",
        "`journalctl -u twind` tells what it said last; memory, a busy machine",
        WARNING,
    ),
    Complaint(
        "DAEMON_FAULT",
        "the daemon itself says that something is wrong",
        "it refuses to arm, or holds the robot, until that is mended and, where it was latched, reset",
        "mend what its message says; then `twindctl reset`, if `twindctl status` still lists it",
        FAULT,
        caution=SUPPORT,
    ),
    Complaint(
        "TICKS_MISSED",
        "the loop misses ticks",
        "goals reach the servos late; after 100 ms without a packet they stop by themselves",
        "real-time rights (NO_REALTIME), fewer programs beside it, `cpu:` in the settings, a lower `rate_hz`",
        WARNING,
    ),
)

ROWS: tuple[Complaint, ...] = (*FILES, *DAEMON, *PORTS, *MACHINE)
