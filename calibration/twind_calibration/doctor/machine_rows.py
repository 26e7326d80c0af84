"""The complaints about the machine itself: real time, processors, clock, disks, software."""

from twind.loop.realtime import LIMIT
from twind_calibration.doctor.cautions import SUPPORT
from twind_calibration.doctor.complaint import Complaint, Severity

FAULT, WARNING, NOTE = Severity.FAULT, Severity.WARNING, Severity.NOTE

MACHINE: tuple[Complaint, ...] = (
    Complaint(
        "STATE_UNWRITABLE",
        "the daemon cannot write its state folder",
        "calibrations, recordings and dumps are lost",
        "`sudo chown twind: /var/lib/twind`, and of what is in it that is the daemon's; as a "
        "service, `StateDirectory=twind` in the unit does it",
        FAULT,
        caution="look what is in the folder: it must be the daemon's alone, for other programs "
        "lose the files that it takes over",
    ),
    Complaint(
        "DISK_FULL",
        "a disk is full, or nearly",
        "recordings and dumps after a fault are cut off, a calibration cannot be saved, logs end",
        "`df -h`, `du -xh --max-depth=2 / | sort -h | tail`; `sudo journalctl --vacuum-size=500M`",
        WARNING,
        caution="copy recordings, dumps and logs of a fault first: what is deleted cannot be "
        "looked into any more",
        explains=("STATE_UNWRITABLE",),
    ),
    Complaint(
        "NO_REALTIME",
        "the loop has no real-time scheduling",
        "any busy program delays it: late ticks, jerks, in the end the servos' watchdogs",
        f'as its service it may; by hand, `echo "$USER - rtprio {LIMIT}" | sudo tee -a '
        "/etc/security/limits.d/twind.conf`, then log in again; in a container `--cap-add SYS_NICE`",
        WARNING,
        explains=("TICKS_MISSED",),
    ),
    Complaint(
        "MEMORY_UNLOCKED",
        "the loop's memory is not locked",
        "a page that was swapped out costs a tick",
        'as its service it may; by hand, `echo "$USER - memlock unlimited" | sudo tee -a '
        "/etc/security/limits.d/twind.conf`, then log in again; in a container `--cap-add IPC_LOCK`",
        WARNING,
    ),
    Complaint(
        "CPU_FEW",
        "too few processors",
        "loop, front and your own programs take turns: late ticks",
        "two cores or more; in a virtual machine or container, give it more",
        NOTE,
    ),
    Complaint(
        "CPU_GOVERNOR",
        "the processors are told to save power",
        "a core that sleeps or is clocked down wakes the loop late",
        "`echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor`",
        NOTE,
        caution="a small board needs cooling for it, and a battery gets empty sooner",
    ),
    Complaint(
        "RT_RIVAL",
        "another program runs at the loop's real-time priority or above",
        "when it computes, the loop waits",
        "give it other cores than the loop (`cpu:` in the settings); where it drives and watches "
        "nothing, a lower "
        "priority: `sudo chrt -f -p 10 PID`",
        WARNING,
        caution="find out what it is: a program that drives motors or watches over something must "
        "not be made slower",
        explains=("TICKS_MISSED",),
    ),
    Complaint(
        "CLOCK_UNSYNCED",
        "the clock is not synchronised",
        "stamps of logs and recordings do not fit those of other machines; the loop itself does not mind",
        "`sudo timedatectl set-ntp true`",
        NOTE,
    ),
    Complaint(
        "CLOCK_WRONG",
        "the clock is wrong: files of the robot come from its future",
        "logs and recordings get wrong dates and are sorted wrongly; a certificate may be refused",
        "`sudo timedatectl set-ntp true`, or `sudo date -s 'YYYY-MM-DD HH:MM'`",
        WARNING,
        explains=("CLOCK_UNSYNCED",),
    ),
    Complaint(
        "SOFTWARE_OLD",
        "a program or library is older than twind needs",
        "it fails where the newer one works, sometimes only in mid-motion",
        "`sudo make install` in the sources, or the newer package: both bring their libraries; "
        "systemd 252, Python 3.11 or newer",
        WARNING,
        caution=SUPPORT,
    ),
)
