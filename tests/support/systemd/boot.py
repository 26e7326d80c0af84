"""Makes a throw-away root file system and becomes its init: run by `machine.py` as the first process of new
namespaces (pid, mount, cgroup, ipc, uts, net). Standard library only.

    boot.py FOLDER PLAN        FOLDER: an empty directory; PLAN: a JSON file, {"bind": {inside: outside}}

Every mount is made here, in the private mount namespace: when the last process of it has gone, so have they.
FOLDER/tree, if it is there, is laid over `/`.
"""

import grp
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

INIT = "/lib/systemd/systemd"
TARGET = "twind-tests.target"
FAVOURED = -10  # before the other programs of this machine: so are its services (Nice=), and the robots
DEVICES = ("null", "zero", "full", "random", "urandom", "tty")
ENVIRONMENT = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "TERM": "dumb", "container": "twind-tests"}

# Nothing of the machine itself may start or be touched. Never a real udevd: its coldplug writes to the
# `uevent` file of every device in sysfs, which is the machine's own, whatever the namespace.
MASKED = """
    systemd-udevd.service systemd-udevd-control.socket systemd-udevd-kernel.socket
    systemd-udev-trigger.service systemd-udev-settle.service systemd-hwdb-update.service getty.target
    getty@tty1.service serial-getty@ttyS0.service systemd-logind.service systemd-firstboot.service
    systemd-timesyncd.service systemd-networkd.service systemd-resolved.service systemd-remount-fs.service
    systemd-update-utmp.service systemd-modules-load.service systemd-sysctl.service systemd-binfmt.service
    systemd-random-seed.service systemd-journal-flush.service systemd-journal-catalog-update.service
    systemd-update-done.service systemd-pcrphase.service systemd-pcrphase-sysinit.service ldconfig.service
    proc-sys-fs-binfmt_misc.automount dev-hugepages.mount dev-mqueue.mount sys-kernel-debug.mount
    sys-kernel-tracing.mount sys-kernel-config.mount sys-fs-fuse-connections.mount
    systemd-journald-audit.socket modprobe@.service systemd-tmpfiles-clean.timer apt-daily.timer
    man-db.timer apt-daily-upgrade.timer dpkg-db-backup.timer e2scrub_all.timer fstrim.timer
"""


def mount(*arguments: object) -> None:
    """mount(8), without a line in any table. Raises CalledProcessError."""
    subprocess.run(["mount", "-n", *map(str, arguments)], check=True)


def write(path: Path, text: str = "") -> None:
    """A file and the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def lay(upper: Path) -> None:
    """Write the files on top of `/` of every machine: units that may not start, and a target of our own."""
    units = upper / "etc/systemd/system"
    units.mkdir(parents=True)
    for name in MASKED.split():
        (units / name).symlink_to("/dev/null")
    write(
        units / TARGET,
        "[Unit]\nDescription=What the tests need\nRequires=sysinit.target\n"
        "After=sysinit.target sockets.target\nWants=systemd-journald.service\nAllowIsolate=yes\n",
    )
    write(upper / "etc/systemd/journald.conf.d/tests.conf", "[Journal]\nStorage=volatile\nRateLimitBurst=0\n")
    write(upper / "etc/fstab")
    write(upper / "etc/machine-id", os.urandom(16).hex() + "\n")


def over(folder: Path) -> Path:
    """`/` with a layer of our own on it, in memory."""
    tree = folder / "tree"
    layer = folder / "layer"
    layer.mkdir()
    mount("-t", "tmpfs", "-o", "size=1g,mode=755", "twind-tests", layer)
    upper = layer / "upper"
    work = layer / "work"
    root = layer / "root"
    for each in (upper, work, root):
        each.mkdir()
    lay(upper)
    if tree.is_dir():
        shutil.copytree(tree, upper, symlinks=True, dirs_exist_ok=True)
    mount("-t", "overlay", "-o", f"lowerdir=/,upperdir={upper},workdir={work}", "overlay", root)
    return root


def furnish(root: Path) -> None:
    """The kernel's file systems. sysfs can be written, or PID 1 knows no device units: so nobody may."""
    mount("-t", "proc", "-o", "nosuid,noexec,nodev", "proc", root / "proc")
    mount("--bind", root / "proc/sys", root / "proc/sys")
    mount("-o", "remount,bind,ro", root / "proc/sys")
    mount("-t", "sysfs", "-o", "nosuid,noexec,nodev", "sysfs", root / "sys")
    mount("-t", "cgroup2", "-o", "nosuid,noexec,nodev", "cgroup2", root / "sys/fs/cgroup")
    dev = root / "dev"
    mount("-t", "tmpfs", "-o", "mode=755,nosuid", "tmpfs", dev)
    for name in DEVICES:
        (dev / name).touch()
        mount("--bind", f"/dev/{name}", dev / name)
    for name in ("pts", "shm"):
        (dev / name).mkdir()
    mount("-t", "tmpfs", "-o", "mode=1777", "tmpfs", dev / "shm")
    # As udev would have them: every pseudo-terminal is root:dialout 0660, and so stands for a serial adapter.
    owned = f"gid={grp.getgrnam('dialout').gr_gid},mode=660"
    mount("-t", "devpts", "-o", f"newinstance,ptmxmode=0666,{owned}", "devpts", dev / "pts")
    links = {"ptmx": "pts/ptmx", "fd": "/proc/self/fd", "stdin": "/proc/self/fd/0"}
    for name, to in {**links, "stdout": "/proc/self/fd/1", "stderr": "/proc/self/fd/2"}.items():
        (dev / name).symlink_to(to)
    mount("-t", "tmpfs", "-o", "mode=755,nosuid", "tmpfs", root / "run")
    mount("-t", "tmpfs", "-o", "mode=1777", "tmpfs", root / "tmp")
    # PID 1 listens to udev's messages only where udevd has been; `udev.py` sends them.
    write(root / "run/udev/control")
    (root / "run/udev/data").mkdir()
    (root / "run/udev/tags/systemd").mkdir(parents=True)


def bind(root: Path, folders: dict[str, str]) -> None:
    """Folders of the machine seen elsewhere, read only: a hardened unit cannot look into /root or /home."""
    for inside, outside in folders.items():
        place = root / inside.lstrip("/")
        place.mkdir(parents=True, exist_ok=True)
        mount("--bind", outside, place)
        mount("-o", "remount,bind,ro", place)


def enter(root: Path) -> None:
    """Make `root` the root and let go of the old one."""
    os.chdir(root)
    Path(".old").mkdir()
    subprocess.run(["pivot_root", ".", ".old"], check=True)
    os.chroot(".")
    os.chdir("/")
    subprocess.run(["umount", "-n", "-l", "/.old"], check=True)
    Path("/.old").rmdir()
    mount(
        "--make-rshared", "/"
    )  # as a PID 1 has it that is in no container: services' own mounts come through


def main() -> None:
    """Does not return: PID 1 is systemd afterwards."""
    # As a kernel starts it, whatever we run as.
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.setpriority(os.PRIO_PROCESS, 0, FAVOURED)
    folder = Path(sys.argv[1])
    plan = json.loads(Path(sys.argv[2]).read_text())
    root = over(folder)
    furnish(root)
    bind(root, plan["bind"])
    subprocess.run(["hostname", "twind-tests"], check=True)
    enter(root)
    options = ["--system", f"--unit={TARGET}", "--show-status=no", "--log-target=journal-or-kmsg"]
    os.execve(INIT, [INIT, *options], ENVIRONMENT)


if __name__ == "__main__":
    main()
