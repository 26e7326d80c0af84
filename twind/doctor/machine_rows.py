"""The complaints about the machine itself: real time, processors, clock, disks, software."""

from twind.doctor.cautions import SUPPORT
from twind.doctor.check import Check, Severity
from twind.loop.realtime import LIMIT

FAULT = Severity.FAULT
WARNING = Severity.WARNING
NOTE = Severity.NOTE

MACHINE: tuple[Check, ...] = (
    Check(
        "STATE_UNWRITABLE",
        "the daemon cannot write its state folder",
        "calibrations, recordings and dumps are lost",
        (
            "`sudo chown twind: /var/lib/twind` and the daemon's files there; as a service "
            "`StateDirectory=twind`"
        ),
        FAULT,
        caution="the folder must be the daemon's alone: other programs lose files that change owner",
    ),
    Check(
        "DISK_FULL",
        "a disk is full or almost full",
        "recordings, dumps, calibrations and logs are cut off or lost",
        "`df -h`, `du -xh --max-depth=2 / | sort -h | tail`; `sudo journalctl --vacuum-size=500M`",
        WARNING,
        caution="first copy recordings, dumps and logs of a fault",
        explains=("STATE_UNWRITABLE",),
    ),
    Check(
        "NO_REALTIME",
        "the loop has no real-time scheduling",
        "any busy program delays ticks, up to the servo watchdogs",
        f'the service has it; by hand `echo "$USER - rtprio {LIMIT}" | sudo tee -a '
        "/etc/security/limits.d/twind.conf`, then log in again; in a container `--cap-add SYS_NICE`",
        WARNING,
        explains=("TICKS_MISSED",),
    ),
    Check(
        "MEMORY_UNLOCKED",
        "the loop's memory is not locked",
        "a swapped page costs a tick",
        'the service has it; by hand `echo "$USER - memlock unlimited" | sudo tee -a '
        "/etc/security/limits.d/twind.conf`, then log in again; in a container `--cap-add IPC_LOCK`",
        WARNING,
    ),
    Check(
        "CPU_FEW",
        "too few processors",
        "loop, front process and your programs compete: late ticks",
        "use two cores or more, also in a virtual machine or container",
        NOTE,
    ),
    Check(
        "CPU_GOVERNOR",
        "the processors save power",
        "a sleeping or slow core delays the loop",
        "`echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor`",
        NOTE,
        caution="a small board needs cooling, and a battery empties sooner",
    ),
    Check(
        "RT_RIVAL",
        "another program has equal or higher real-time priority",
        "while it computes, the loop waits",
        (
            "give it other cores (`cpu:` in the settings); if it drives and monitors nothing: `sudo chrt "
            "-f -p 10 PID`"
        ),
        WARNING,
        caution="find out what it is: a program that drives motors or monitors safety must not be slowed",
        explains=("TICKS_MISSED",),
    ),
    Check(
        "CLOCK_UNSYNCED",
        "the clock is not synchronised",
        "time stamps differ from other machines; the loop is not affected",
        "`sudo timedatectl set-ntp true`",
        NOTE,
    ),
    Check(
        "CLOCK_WRONG",
        "the clock is wrong: robot files lie in the future",
        "logs and recordings get wrong dates; certificates may be refused",
        "`sudo timedatectl set-ntp true`, or `sudo date -s 'YYYY-MM-DD HH:MM'`",
        WARNING,
        explains=("CLOCK_UNSYNCED",),
    ),
    Check(
        "SOFTWARE_OLD",
        "a program or library is too old",
        "it may fail, sometimes during motion",
        "`sudo make install`, or the newer package; systemd 252, Python 3.11 or newer",
        WARNING,
        caution=SUPPORT,
    ),
)
