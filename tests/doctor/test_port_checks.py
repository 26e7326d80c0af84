"""The doctor finds what is wrong with serial ports: real nodes and holders, planted folders of /sys, /dev."""

import fcntl
import os
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.doctor_rig import ROOT, found, host, look, mended, nobody, plant, way_to
from tests.support.port_checks_rig import codes
from twind.doctor import latency_test
from twind.doctor.host_inspector import HostInspector

needs_root = pytest.mark.skipif(not ROOT, reason="makes device nodes and looks as another user: needs root")
MINOR = 250  # of a node that no driver serves: opening it would fail, and nobody opens it


@pytest.fixture
def pty() -> Iterator[str]:
    """A port that is there, free, and silent."""
    master, slave = os.openpty()
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


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


# ------------------------------------------------------------------------------------------- is it there


def test_a_port_that_is_not_there_is_found_with_the_names_that_are(tmp_path: Path) -> None:
    link = tmp_path / "dev/serial/by-id/usb-FTDI_FT0000-if00-port0"
    link.parent.mkdir(parents=True)
    link.symlink_to("/dev/null")
    (finding,) = found(
        "--port", str(tmp_path / "ttyUSB7"), code="PORT_MISSING", on=host(dev=tmp_path / "dev")
    )
    assert finding.thing == str(tmp_path / "ttyUSB7") and "bus main" in finding.measured
    assert str(link) in finding.advice


def test_a_port_that_is_there_is_not_missing(pty: str) -> None:
    for code in ("PORT_MISSING", "PORT_UNFIT", "PORT_RENUMBERED", "PORT_UNSET"):
        assert codes(pty, code) == []


def test_a_file_is_no_port(tmp_path: Path) -> None:
    file = plant(tmp_path / "port", "")
    assert codes(file, "PORT_UNFIT") == [str(file)]


def test_a_bus_without_a_port_is_a_note_that_lists_what_is_plugged_in(tmp_path: Path) -> None:
    plant(tmp_path / "ttyACM3", "")
    (finding,) = found(code="PORT_UNSET", on=host(dev=tmp_path))
    assert finding.thing == "bus main" and str(tmp_path / "ttyACM3") in finding.measured


@needs_root
def test_a_number_is_told_with_the_name_that_stays(tmp_path: Path) -> None:
    port = node(tmp_path / "ttyUSB0")
    link = tmp_path / "serial/by-id/usb-FTDI_FT0000-if00-port0"
    link.parent.mkdir(parents=True)
    link.symlink_to(port)
    (finding,) = found("--port", str(port), code="PORT_RENUMBERED", on=host(dev=tmp_path))
    assert finding.expected == str(link) and "ports: {main:" in finding.advice
    assert codes(link, "PORT_RENUMBERED", host(dev=tmp_path)) == []


# ------------------------------------------------------------------------------------------- may we


@needs_root
def test_a_user_without_the_ports_group_is_told_how_to_get_it(tmp_path: Path) -> None:
    for above in way_to(tmp_path):
        os.chmod(above, 0o755)
    port = node(tmp_path / "ttyUSB0", 0o660, group=20)  # dialout on Debian
    found("--port", str(port), code="PORT_DENIED")  # every module is loaded before the user is another one
    with nobody():
        (finding,) = found("--port", str(port), code="PORT_DENIED")
    assert "this user nobody may not" in finding.measured and "0660" in finding.measured
    assert finding.command.startswith("sudo usermod -aG ") and finding.command.endswith(" nobody")
    assert "log in again" in finding.advice
    with nobody(20):
        assert codes(port, "PORT_DENIED") == []


@needs_root
def test_a_port_that_no_group_may_open_is_not_answered_with_a_group(tmp_path: Path) -> None:
    for above in way_to(tmp_path):
        os.chmod(above, 0o755)
    port = node(tmp_path / "ttyUSB0", 0o600)
    found("--port", str(port), code="PORT_DENIED")
    with nobody():
        (finding,) = found("--port", str(port), code="PORT_DENIED")
    assert finding.command == "" and "udev rules" in finding.advice


# ------------------------------------------------------------------------------------------- who has it


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
def test_a_program_that_probes_new_ports_is_found_where_udev_does_not_keep_it_away(
    port_of_udev: Path, answer: str, wrong: bool
) -> None:
    udev_says(port_of_udev, answer)
    on = host(proc=port_of_udev.parent / "proc")
    findings = found("--port", str(port_of_udev), code="PORT_PROBED", on=on)
    assert [each.command for each in findings] == [""] * wrong  # it may be what connects this machine
    assert all(each.advice.startswith("install twind's udev rules") for each in findings)
    assert all("pid 4242" in each.measured for each in findings)


@needs_root
def test_where_udev_cannot_be_asked_nobody_is_accused_of_probing(port_of_udev: Path) -> None:
    on = host(proc=port_of_udev.parent / "proc")
    outcome = look("--port", str(port_of_udev), on=on, only=["PORT_PROBED"])
    assert (outcome.found, outcome.unseen) == ([], [("probing programs", "udevadm is not installed")])


@needs_root
def test_a_braille_display_is_not_masked_because_it_runs(port_of_udev: Path) -> None:
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
def test_nobody_is_told_to_kill_another_daemon(
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


# ------------------------------------------------------------------------------------------- /sys


def tty(sys_folder: Path, port: str, usb: str = "1-1.4") -> Path:
    """What /sys would say of an FTDI adapter behind `port`: its tty's `device` folder."""
    device = sys_folder / f"devices/pci0/usb1/{usb}/{usb}:1.0/ttyUSB0"
    device.mkdir(parents=True)
    plant(sys_folder / f"devices/pci0/usb1/{usb}/idVendor", "0403\n")
    plant(sys_folder / f"devices/pci0/usb1/{usb}/power/control", "on\n")
    plant(sys_folder / f"devices/pci0/usb1/{usb}/power/autosuspend_delay_ms", "2000\n")
    plant(device / "latency_timer", "1\n")
    driver = sys_folder / "bus/usb-serial/drivers/ftdi_sio"
    driver.mkdir(parents=True)
    (device / "driver").symlink_to(driver)
    link = sys_folder / "class/tty" / os.path.basename(port) / "device"
    link.parent.mkdir(parents=True)
    link.symlink_to(device)
    return device


def test_a_good_adapter_gives_no_alarm(pty: str, tmp_path: Path) -> None:
    tty(tmp_path, pty)
    for code in ("LATENCY_TIMER", "USB_AUTOSUSPEND", "USB_HUBS", "BAUD_UNSUPPORTED"):
        assert codes(pty, code, host(sys=tmp_path)) == []


def test_a_long_latency_timer_is_found_and_mended(pty: str, tmp_path: Path) -> None:
    file = plant(tty(tmp_path, pty) / "latency_timer", "16\n")
    on = host(sys=tmp_path)
    (finding,) = found("--port", pty, code="LATENCY_TIMER", on=on)
    assert (finding.measured, finding.expected) == ("latency timer 16 ms", "1 ms")
    assert finding.command.startswith("echo 1 | sudo tee ") and finding.fix is not None
    (tried,) = mended("--port", pty, code="LATENCY_TIMER", on=on)
    assert (tried.error, tried.there) == ("", False) and file.read_text() == "1\n"


@needs_root
def test_a_timer_that_this_user_may_not_write_is_left_and_said_so(pty: str, tmp_path: Path) -> None:
    for above in way_to(tmp_path):
        os.chmod(above, 0o755)
    file = plant(tty(tmp_path, pty) / "latency_timer", "16\n")
    os.chmod(file, 0o644)
    on = host(sys=tmp_path)
    found("--port", pty, code="LATENCY_TIMER", on=on)
    with nobody():
        (tried,) = mended("--port", pty, code="LATENCY_TIMER", on=on)
    assert "Permission denied" in tried.error and tried.there and file.read_text() == "16\n"


def test_an_adapter_that_may_fall_asleep_is_found_and_kept_awake(pty: str, tmp_path: Path) -> None:
    device = tty(tmp_path, pty)
    control = plant(device.parents[1] / "power/control", "auto\n")
    on = host(sys=tmp_path)
    assert codes(pty, "USB_AUTOSUSPEND", on) == [pty]
    (tried,) = mended("--port", pty, code="USB_AUTOSUSPEND", on=on)
    assert not tried.there and control.read_text() == "on\n"


def test_an_adapter_whose_delay_is_negative_never_sleeps(pty: str, tmp_path: Path) -> None:
    device = tty(tmp_path, pty)
    plant(device.parents[1] / "power/control", "auto\n")
    plant(device.parents[1] / "power/autosuspend_delay_ms", "-1\n")
    assert codes(pty, "USB_AUTOSUSPEND", host(sys=tmp_path)) == []


def test_three_hubs_are_one_too_many(pty: str, tmp_path: Path) -> None:
    tty(tmp_path, pty, usb="1-1.4.2.3")
    (finding,) = found("--port", pty, code="USB_HUBS", on=host(sys=tmp_path))
    assert "3 hubs (1-1.4.2.3)" in finding.measured


def test_a_rate_that_the_adapters_driver_cannot_do_is_found(pty: str, tmp_path: Path) -> None:
    device = tty(tmp_path, pty)
    (device / "driver").unlink()
    slow = tmp_path / "bus/usb-serial/drivers/ch341-uart"
    slow.mkdir(parents=True)
    (device / "driver").symlink_to(slow)
    fast = Path(__file__).parents[2] / "twind/robots/h24.yaml"
    text = fast.read_text()
    assert "baud: 2000000" in text
    robot = plant(tmp_path / "robot/h24.yaml", text.replace("baud: 2000000", "baud: 4000000"))
    shutil.copy(fast.with_suffix(".xml"), robot.parent)
    (finding,) = found("--port", pty, "--robot", str(robot), code="BAUD_UNSUPPORTED", on=host(sys=tmp_path))
    assert "4000000 baud asked for" in finding.measured and "ch341-uart does 2000000" in finding.measured
    assert codes(pty, "BAUD_UNSUPPORTED", host(sys=tmp_path)) == []


def test_the_holders_of_a_locked_node_are_read_from_the_kernels_list(pty: str) -> None:
    """Our own lock is not told: it is the doctor's."""
    fd = os.open(pty, os.O_RDWR | os.O_NOCTTY)
    fcntl.flock(fd, fcntl.LOCK_EX)
    try:
        assert HostInspector().holders(pty) == []
        assert list(HostInspector()._lockers(pty)) == [os.getpid()]
    finally:
        os.close(fd)


@pytest.mark.parametrize(("timer_ms", "bound"), [(0, 4e-3), (1, 4e-3), (4, 7e-3), (16, 19e-3)])
def test_answers_are_late_beyond_the_timer_that_the_robot_file_reckons_with(
    timer_ms: float, bound: float
) -> None:
    def late(took: float) -> list[str]:
        return [each.code for each in latency_test.judge("port", took, 1e-3, timer_ms, "a ping")]

    assert late(1e-3 + bound - 1e-6) == []
    assert late(1e-3 + bound + 1e-6) == ["LATENCY_FLOOR"]
