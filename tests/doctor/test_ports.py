"""Findings about ports: real nodes and holders, planted folders of /sys and /dev."""

import fcntl
import os
import stat
from pathlib import Path

import pytest

from tests.support.doctor_rig import (
    codes,
    found,
    host,
    look,
    needs_root,
    plant,
    unprivileged,
    way_to,
)
from twind.doctor.host_inspector import HostInspector

MINOR = 250  # of a node that no driver serves: opening it would fail


def node(path: Path, mode: int = 0o660, group: int = 0) -> Path:
    """A character device of no driver."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.mknod(path, stat.S_IFCHR | mode, os.makedev(188, MINOR))
    except PermissionError:
        pytest.skip("device nodes may not be made here")
    os.chmod(path, mode)
    os.chown(path, 0, group)
    return path


def test_a_port_that_is_not_there_is_found_with_the_names_that_are(tmp_path: Path) -> None:
    link = tmp_path / "dev/serial/by-id/usb-FTDI_FT0000-if00-port0"
    link.parent.mkdir(parents=True)
    link.symlink_to("/dev/null")
    (finding,) = found(
        "--port", str(tmp_path / "ttyUSB7"), code="PORT_MISSING", on=host(dev=tmp_path / "dev")
    )
    assert finding.thing == str(tmp_path / "ttyUSB7") and "bus main" in finding.measured
    assert str(link) in finding.advice


def test_the_port_of_a_program_that_has_ended_is_nothing_to_plug_in() -> None:
    (finding,) = found("--port", "/dev/pts/999999", code="PORT_MISSING")
    assert "the program that served this port has ended (bus main)" in finding.measured
    assert "twind-virtual" in finding.advice and "plug" not in finding.advice
    assert finding.caution == ""


def test_a_port_that_is_there_is_not_missing(pty: str) -> None:
    for code in ("PORT_MISSING", "PORT_UNSET"):
        assert codes(pty, code) == []


def test_a_file_is_no_port(tmp_path: Path) -> None:
    file = plant(tmp_path / "port", "")
    assert codes(file, "PORT_MISSING") == [str(file)]


def test_bus_without_port_is_a_note_that_lists_adapters(tmp_path: Path) -> None:
    plant(tmp_path / "ttyACM3", "")
    (finding,) = found(code="PORT_UNSET", on=host(dev=tmp_path))
    assert finding.thing == "bus main" and str(tmp_path / "ttyACM3") in finding.measured


@needs_root
def test_numbered_port_is_reported_with_its_permanent_name(tmp_path: Path) -> None:
    port = node(tmp_path / "ttyUSB0")
    link = tmp_path / "serial/by-id/usb-FTDI_FT0000-if00-port0"
    link.parent.mkdir(parents=True)
    link.symlink_to(port)
    (finding,) = found("--port", str(port), code="PORT_UNSET", on=host(dev=tmp_path))
    assert finding.expected == str(link) and "ports: {main:" in finding.advice
    assert codes(link, "PORT_UNSET", host(dev=tmp_path)) == []


@needs_root
def test_user_outside_the_group_of_the_port_gets_the_command(tmp_path: Path) -> None:
    for above in way_to(tmp_path):
        os.chmod(above, 0o755)
    port = node(tmp_path / "ttyUSB0", 0o660, group=20)  # dialout on Debian
    found("--port", str(port), code="PORT_DENIED")  # every module is loaded before the user is another one
    with unprivileged():
        (finding,) = found("--port", str(port), code="PORT_DENIED")
    assert "this user nobody may not" in finding.measured and "0660" in finding.measured
    assert finding.command.startswith("sudo usermod -aG ") and finding.command.endswith(" nobody")
    assert "log in again" in finding.advice
    with unprivileged(20):
        assert codes(port, "PORT_DENIED") == []


@needs_root
def test_a_port_that_no_group_may_open_is_not_answered_with_a_group(tmp_path: Path) -> None:
    for above in way_to(tmp_path):
        os.chmod(above, 0o755)
    port = node(tmp_path / "ttyUSB0", 0o600)
    found("--port", str(port), code="PORT_DENIED")
    with unprivileged():
        (finding,) = found("--port", str(port), code="PORT_DENIED")
    assert finding.command == "" and "udev rules" in finding.advice


@pytest.fixture
def port_of_udev(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A port that is called as USB adapters are, where nobody but ModemManager (pid 4242) runs."""
    plant(tmp_path / "proc/4242/comm", "ModemManager\n")
    (tmp_path / "bin").mkdir()
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    return node(tmp_path / "ttyACM0")


def udev_says(port: Path, answer: str) -> None:
    """To who asks for the properties of this port, and to nobody else."""
    asked = f"info --query=property --name=/dev/{port.name}"
    said = plant(port.parent / "bin/udevadm", f'#!/bin/sh\n[ "$*" = "{asked}" ] && echo "{answer}"\n')
    said.chmod(0o755)


@needs_root
@pytest.mark.parametrize(
    ("answer", "wrong"),
    [("DEVNAME=/dev/ttyACM0", True), ("ID_MM_DEVICE_IGNORE=1", False), ("ID_MM_PORT_IGNORE=1", False)],
)
def test_modem_manager_is_reported_unless_udev_keeps_it_away(
    port_of_udev: Path, answer: str, wrong: bool
) -> None:
    udev_says(port_of_udev, answer)
    on = host(proc=port_of_udev.parent / "proc")
    findings = found("--port", str(port_of_udev), code="PORT_PROBED", on=on)
    assert [each.command for each in findings] == [""] * wrong  # it may be what connects this machine
    assert all(each.advice.startswith("install twind's udev rules") for each in findings)
    assert all("pid 4242" in each.measured for each in findings)


@needs_root
def test_probing_check_without_udevadm_is_unavailable(port_of_udev: Path) -> None:
    on = host(proc=port_of_udev.parent / "proc")
    outcome = look("--port", str(port_of_udev), on=on, only=["PORT_PROBED"])
    assert (outcome.found, outcome.unseen) == ([], [("probing programs", "udevadm is not installed")])


@needs_root
def test_running_brltty_causes_no_finding(port_of_udev: Path) -> None:
    udev_says(port_of_udev, "DEVNAME=/dev/ttyACM0")
    plant(port_of_udev.parent / "proc/4242/comm", "brltty\n")
    assert codes(port_of_udev, "PORT_PROBED", host(proc=port_of_udev.parent / "proc")) == []


@pytest.mark.parametrize(
    ("words", "group", "ask", "end"),
    [
        ("--socket=/tmp/a", "user.slice/session-1.scope", "twindctl --socket /tmp/a doctor", "Ctrl-C where"),
        ("--config x.yaml", "user.slice/session-1.scope", "twindctl doctor", "Ctrl-C where"),
        (
            "",
            "system.slice/twind.service",
            "twindctl doctor",
            "`sudo systemctl stop twind twind-control.socket",
        ),
        (
            "--socket /run/twind/arm",
            "system.slice/system-twind.slice/twind@arm.service",
            "twindctl --socket /run/twind/arm doctor",
            "`sudo systemctl stop twind@arm twind-control@arm.socket",
        ),
    ],
    ids=["told its sockets", "by hand", "service", "instance"],
)
def test_port_held_by_another_daemon_advises_to_ask_it(
    pty: str, tmp_path: Path, words: str, group: str, ask: str, end: str
) -> None:
    """Its command line is longer than the 80 characters that are told of it."""
    program = f"/opt/twind/{'x' * 80}/bin/python /opt/twind/bin/twind --mode live {words}"
    plant(tmp_path / "4242/cmdline", program.replace(" ", "\0") + "\0")
    plant(tmp_path / "4242/cgroup", f"0::/{group}\n")
    (tmp_path / "4242/fd").mkdir()
    (tmp_path / "4242/fd/3").symlink_to(pty)
    (finding,) = found("--port", pty, code="PORT_HELD", on=host(proc=tmp_path))
    assert "pid 4242 (" in finding.measured
    assert finding.command == ""
    assert f"`{ask}`" in finding.advice
    assert end in finding.advice


def test_holders_of_a_locked_port_are_read_from_the_list_of_locks(pty: str, tmp_path: Path) -> None:
    """The list has every user's locks. The process of the doctor is left out: it may lock the port itself."""
    node = os.stat(pty)
    place = f"{os.major(node.st_dev):02x}:{os.minor(node.st_dev):02x}:{node.st_ino}"
    for pid, holders in ((4242, [4242]), (os.getpid(), [])):
        plant(tmp_path / "locks", f"1: FLOCK  ADVISORY  WRITE {pid} {place} 0 EOF\n")
        assert [each.pid for each in host(proc=tmp_path).holders(pty)] == holders


def test_lock_of_a_port_is_in_the_list_of_the_kernel(pty: str) -> None:
    fd = os.open(pty, os.O_RDWR | os.O_NOCTTY)
    fcntl.flock(fd, fcntl.LOCK_EX)
    try:
        inode = f":{os.stat(pty).st_ino} "
        locks = Path("/proc/locks").read_text().splitlines()
        assert [line for line in locks if inode in line and f" {os.getpid()} " in line]
        assert HostInspector().holders(pty) == []
    finally:
        os.close(fd)
