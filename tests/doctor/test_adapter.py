"""Findings about the USB adapter of a port: planted folders of /sys, and bounds of the latency."""

import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.support.doctor_rig import (
    codes,
    found,
    host,
    mended,
    needs_root,
    plant,
    unprivileged,
    way_to,
)
from twind.doctor import adapter
from twind.doctor.check import Severity


def tty(sys_folder: Path, port: str, usb: str = "1-1.4") -> Path:
    """Plant the /sys entries of an FTDI adapter behind `port`; return its tty's `device` folder."""
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
    for code in ("LATENCY_TIMER", "LATENCY_FLOOR", "BAUD_UNSUPPORTED"):
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
def test_fix_of_timer_without_permission_reports_the_error(pty: str, tmp_path: Path) -> None:
    for above in way_to(tmp_path):
        os.chmod(above, 0o755)
    file = plant(tty(tmp_path, pty) / "latency_timer", "16\n")
    os.chmod(file, 0o644)
    on = host(sys=tmp_path)
    found("--port", pty, code="LATENCY_TIMER", on=on)
    with unprivileged():
        (tried,) = mended("--port", pty, code="LATENCY_TIMER", on=on)
    assert "Permission denied" in tried.error and tried.there and file.read_text() == "16\n"


def test_an_adapter_with_autosuspend_is_found_and_fixed(pty: str, tmp_path: Path) -> None:
    device = tty(tmp_path, pty)
    control = plant(device.parents[1] / "power/control", "auto\n")
    on = host(sys=tmp_path)
    assert codes(pty, "LATENCY_TIMER", on) == [pty]
    (tried,) = mended("--port", pty, code="LATENCY_TIMER", on=on)
    assert not tried.there and control.read_text() == "on\n"


def test_an_adapter_with_a_negative_autosuspend_delay_causes_no_finding(pty: str, tmp_path: Path) -> None:
    device = tty(tmp_path, pty)
    plant(device.parents[1] / "power/control", "auto\n")
    plant(device.parents[1] / "power/autosuspend_delay_ms", "-1\n")
    assert codes(pty, "LATENCY_TIMER", host(sys=tmp_path)) == []


def test_three_hubs_are_one_too_many(pty: str, tmp_path: Path) -> None:
    tty(tmp_path, pty, usb="1-1.4.2.3")
    (finding,) = found("--port", pty, code="LATENCY_FLOOR", on=host(sys=tmp_path))
    assert "3 hubs (1-1.4.2.3)" in finding.measured
    assert finding.severity is Severity.NOTE


def test_a_missing_port_has_no_wrong_rate(tmp_path: Path) -> None:
    port = str(tmp_path / "ttyUSB0")
    assert codes(port, "PORT_MISSING") == [port]
    assert codes(port, "BAUD_UNSUPPORTED") == []


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


@pytest.mark.parametrize(("timer_ms", "bound"), [(0, 4e-3), (1, 4e-3), (4, 7e-3), (16, 19e-3)])
def test_answers_are_late_beyond_the_timer_that_the_robot_file_reckons_with(
    timer_ms: float, bound: float
) -> None:
    def late(took: float) -> list[str]:
        return [each.code for each in adapter.judge_latency("port", took, 1e-3, timer_ms, "a ping")]

    assert late(1e-3 + bound - 1e-6) == []
    assert late(1e-3 + bound + 1e-6) == ["LATENCY_FLOOR"]


def test_late_replies_of_a_running_daemon_are_found_with_both_remedies() -> None:
    """Readings that are lost to lateness look like silence: the daemon reports the delay itself."""
    rows = [
        {"name": "left", "port": "/dev/ttyUSB0", "late_reply_ms": 15.6, "errors": 90, "exchanges": 100},
        {"name": "right", "port": "/dev/ttyUSB1", "late_reply_ms": None, "errors": 0, "exchanges": 100},
    ]
    daemon = SimpleNamespace(status={"buses": rows}, latency={})
    robot = SimpleNamespace(buses=[SimpleNamespace(name="left", kind="dynamixel2")])
    context = SimpleNamespace(daemon=daemon, sim=False, need_daemon=lambda: daemon, need_robot=lambda: robot)
    (finding,) = adapter.check_latency(context)  # type: ignore[arg-type]
    assert (finding.code, finding.thing) == ("LATENCY_FLOOR", "/dev/ttyUSB0")
    assert "16 ms after their request" in finding.measured
    assert "latency timer to 1 ms" in finding.advice and "return_delay_time" in finding.advice
