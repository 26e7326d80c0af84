"""The complaints about machine, files and daemon: rows of the doctor's table, in order of cause."""

from twind.doctor.cautions import SUPPORT
from twind.doctor.check import Check, Severity
from twind.doctor.machine_rows import MACHINE
from twind.doctor.port_rows import PORTS

FAULT = Severity.FAULT
WARNING = Severity.WARNING
NOTE = Severity.NOTE

FILES = (
    Check(
        "FILE_REFUSED",
        "a file of the robot is not usable",
        "the daemon does not start; a reload is refused",
        "correct the line and column in the message; it names the nearest key",
        FAULT,
        explains=("UNIT_FAILED", "NO_DAEMON"),
    ),
    Check(
        "MODEL_UNFIT",
        "robot file and MuJoCo model do not match",
        "the daemon does not start: joints and servos cannot be assigned",
        "correct the robot file or the model; see `twindctl check robot FILE`",
        FAULT,
        explains=("UNIT_FAILED", "NO_DAEMON"),
    ),
    Check(
        "MODEL_NO_LIMITS",
        "joints of the model have no range",
        "only the robot file limits motion; an error there stays unnoticed",
        'write `range="LOWER UPPER"` at these joints of the model',
        WARNING,
        caution="torque off, move the joint by hand over the range: a range too wide hits the endstop",
    ),
    Check(
        "CALIBRATION_MISSING",
        "this robot has no calibration",
        "zeros are unknown: `live` is refused, `mirror` shows an estimate",
        "see calibration/README.md; another file: `--calibration FILE`",
        WARNING,
    ),
    Check(
        "CALIBRATION_UNFIT",
        "the calibration belongs to another robot or was edited",
        "wrong zeros give wrong positions: the daemon refuses the file",
        (
            "restore this robot's file STATE/calibration/NAME.yaml (`individual:` of the settings), or "
            "calibrate again"
        ),
        FAULT,
        caution=(
            "wrong zeros move the robot to wrong positions: compare with the monitor in mirror before arming"
        ),
        explains=("UNIT_FAILED", "NO_DAEMON"),
    ),
    Check(
        "FILES_EDITED",
        "a file changed after the daemon read it",
        "the daemon uses the old file and refuses to arm",
        "`twindctl reload`, or disarm and `sudo systemctl restart twind`",
        WARNING,
        caution=SUPPORT,
    ),
)

DAEMON = (
    Check(
        "UNIT_FAILED",
        "the service failed or was given up",
        "no daemon runs; after 5 starts in 30 s the manager stops trying",
        (
            "correct the cause in its last lines, then `sudo systemctl reset-failed twind`, `sudo "
            "systemctl start twind`"
        ),
        FAULT,
        caution="servos may have torque: support the robot before you start the daemon and disarm",
        explains=("NO_DAEMON",),
    ),
    Check(
        "UNIT_RESTARTED",
        "the service manager restarted the service",
        "the daemon crashed or hung; only the servo watchdogs stopped the robot",
        "`journalctl -u twind` shows the cause",
        WARNING,
    ),
    Check(
        "DAEMON_DENIED",
        "this user may not access the running daemon",
        "every `twindctl` fails; only the group of a socket may use it",
        (
            "`sudo usermod -aG twind-operator $USER`, then log in again (`newgrp twind-operator` for this "
            "shell); a daemon of root: use the service"
        ),
        FAULT,
        caution="members of that group may move the robot; a daemon that ends lowers it: support it",
        explains=("NO_DAEMON", "PORT_HELD"),
    ),
    Check(
        "DAEMON_SILENT",
        "the daemon accepts the connection but does not answer",
        "no command arrives, not even an e-stop by this socket",
        (
            "retry; then `sudo systemctl restart twind`; in danger use the emergency switch; keep "
            "`journalctl -u twind`"
        ),
        FAULT,
        caution="support the robot: restart or power-off lowers or drops it; a hung loop keeps torque on",
        explains=("PORT_HELD",),
    ),
    Check(
        "NO_DAEMON",
        "no daemon runs",
        "the robot is neither read nor moved; the findings below come without it",
        "`twind`, or `sudo systemctl start twind`; other sockets: `--socket DIR`",
        NOTE,
    ),
    Check(
        "SOCKET_GROUP",
        "a socket has the wrong group",
        "members of twind-operator (twind-observe) cannot use it, or others can",
        (
            "`sudo groupadd -rf twind-operator`, then `sudo chgrp twind-operator "
            "/run/twind/control.sock`; permanently: sysusers.d and the service"
        ),
        WARNING,
        caution="members of that group may arm and move the robot: check them",
        explains=("DAEMON_DENIED",),
    ),
    Check(
        "SOCKET_OPEN",
        "every user of this machine may command the robot",
        "any program can arm and move it",
        "`sudo chmod 0660 /run/twind/control.sock`; folder: `sudo chmod go-w /run/twind`",
        FAULT,
        caution="a program that stops the robot may lose access: add its user to the group first",
    ),
    Check(
        "VERSION_DIFFERS",
        "daemon and twindctl differ in version",
        "the daemon runs an earlier installation and may lack features",
        "disarm, then `sudo systemctl restart twind`; if that does not help, `which -a twind twindctl`",
        WARNING,
        caution=SUPPORT,
    ),
    Check(
        "FRONT_RESTARTED",
        "the front process was restarted",
        "it died or hung for 2 s: leases ended and motion held",
        "`journalctl -u twind` shows its last lines; check memory and load",
        WARNING,
    ),
    Check(
        "DAEMON_FAULT",
        "the daemon reports a fault",
        "it refuses to arm or holds until the cause is corrected",
        "correct what the message names; then `twindctl reset` if `twindctl status` lists it",
        FAULT,
        caution=SUPPORT,
    ),
    Check(
        "TICKS_MISSED",
        "the loop misses ticks",
        "goals arrive late; after 100 ms without a packet servos stop",
        "real-time rights (NO_REALTIME), less load, `cpu:` in the settings, a lower `rate_hz`",
        WARNING,
    ),
)

ROWS: tuple[Check, ...] = (*FILES, *DAEMON, *PORTS, *MACHINE)
