"""The udev rules: their form by a check of our own (and udev's, where it has one), and what they do to
devices, by carrying them out on descriptions. Real udev meets them on a real machine only."""

import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from tests.support.unit_file_parser import SYSTEMD

RULES = SYSTEMD / "udev" / "60-twind.rules"
EXAMPLE = SYSTEMD / "examples" / "61-twind-robot.rules"
TOKEN = re.compile(r'([A-Z]+)(?:\{([\w/.-]+)\})?(==|!=|=|\+=|-=|:=)"([^"]*)"')
MATCHES = {"ACTION", "SUBSYSTEM", "SUBSYSTEMS", "KERNEL", "DRIVER", "ATTR", "ATTRS", "ENV"}
SETS = {"ATTR": {"="}, "ENV": {"=", "+="}, "GOTO": {"="}, "GROUP": {"="}, "LABEL": {"="}, "MODE": {"="}}
SETS |= {"SYMLINK": {"+="}, "TAG": {"+="}}
OF_KEYS = {"ATTR", "ATTRS", "ENV"}  # that need a name in braces

Token = tuple[str, str, str, str]  # key, name in braces, operator, value


def rules(path: Path) -> list[list[Token]]:
    """Each rule as its tokens; anything else on a line is a mistake."""
    found = []
    for number, line in enumerate(path.read_text().splitlines(), 1):
        if line and not line.startswith("#"):
            tokens = [TOKEN.fullmatch(token) for token in line.split(", ")]
            assert all(tokens), f"{path.name}:{number}: {line}"
            found.append([(m[1], m[2] or "", m[3], m[4]) for m in tokens if m is not None])
    return found


@dataclass
class Device:
    """A device as udev shows it: its own values, and those of the USB device that it stands on."""

    subsystem: str
    kernel: str
    driver: str = ""
    env: dict[str, str] = field(default_factory=dict)
    attributes: dict[str, str] = field(default_factory=dict)
    usb: dict[str, str] = field(default_factory=dict)
    symlinks: list[str] = field(default_factory=list)
    got: dict[str, str] = field(default_factory=dict)  # GROUP, MODE, and what was written to attributes
    tags: list[str] = field(default_factory=list)


def fits(device: Device, action: str, token: Token) -> bool:
    key, name, operator, pattern = token
    seen = {
        "ACTION": action,
        "SUBSYSTEM": device.subsystem,
        "SUBSYSTEMS": "usb" if device.usb else device.subsystem,
        "KERNEL": device.kernel,
        "DRIVER": device.driver,
        "ATTR": device.attributes.get(name, ""),
        "ATTRS": device.usb.get(name, ""),
        "ENV": device.env.get(name, ""),
    }[key]
    return any(fnmatchcase(seen, part) for part in pattern.split("|")) == (operator == "==")


def act(device: Device, token: Token) -> None:
    key, name, operator, given = token
    given = re.sub(r"\$attr\{(\w+)\}", lambda found: device.usb[found[1]], given)
    if key == "SYMLINK":
        device.symlinks.append(given)
    elif key == "TAG":
        device.tags.append(given)
    elif key == "ENV":
        device.env[name] = f"{device.env.get(name, '')} {given}".strip() if operator == "+=" else given
    else:
        device.got[f"{key}{{{name}}}" if name else key] = given


def carry_out(device: Device, *paths: Path, action: str = "add") -> Device:
    """Apply the rules to a device that is plugged in, or was."""
    for path in paths:
        target = None
        for rule in rules(path):
            label = next((token[3] for token in rule if token[0] == "LABEL"), None)
            if target is not None and label != target:
                continue
            target = None
            matches = [token for token in rule if token[2] in ("==", "!=")]
            if all(fits(device, action, token) for token in matches):
                for token in rule:
                    if token[0] == "GOTO":
                        target = token[3]
                    elif token not in matches and token[0] != "LABEL":
                        act(device, token)
        assert target is None, f"{path.name}: GOTO {target} leads nowhere"
    return device


def tty(serial: str = "FT0000", vendor: str = "0403", product: str = "6014") -> Device:
    usb = {"idVendor": vendor, "idProduct": product} | ({"serial": serial} if serial else {})
    return Device("tty", "ttyUSB0", env={"ID_SERIAL_SHORT": serial}, usb=usb)


def each_rule() -> Iterator[tuple[str, list[Token]]]:
    for path in (RULES, EXAMPLE):
        for number, rule in enumerate(rules(path)):
            yield f"{path.name}-{number}", rule


@pytest.mark.parametrize("rule", [pytest.param(rule, id=name) for name, rule in each_rule()])
def test_each_token_of_the_rules_is_valid_in_udev(rule: list[Token]) -> None:
    for key, name, operator, given in rule:
        assert bool(name) == (key in OF_KEYS), key
        assert given, key
        if operator in ("==", "!="):
            assert key in MATCHES, key
        else:
            assert operator in SETS[key], f"{key}{operator}"


def test_udev_itself_takes_them() -> None:
    program = shutil.which("udevadm")
    if (
        program is None
        or "verify" not in subprocess.run([program, "--help"], capture_output=True).stdout.decode()
    ):
        pytest.skip("no `udevadm verify` here (systemd 254)")
    done = subprocess.run([program, "verify", RULES, EXAMPLE], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_an_ftdi_port_answers_within_a_millisecond() -> None:
    port = carry_out(Device("usb-serial", "ttyUSB0", driver="ftdi_sio"), RULES)
    assert port.got == {"ATTR{latency_timer}": "1"}
    assert carry_out(Device("usb-serial", "ttyUSB1", driver="cp210x"), RULES).got == {}


def test_a_u2d2_keeps_its_name_has_its_group_and_is_left_alone_by_the_modem_manager() -> None:
    u2d2 = carry_out(tty(), RULES)
    assert u2d2.symlinks == ["twind/FT0000"]
    assert u2d2.got == {"GROUP": "dialout", "MODE": "0660"}
    assert u2d2.env["ID_MM_PORT_IGNORE"] == "1"
    assert u2d2.tags == ["systemd"]
    chip = {"idVendor": "0403", "idProduct": "6014"}
    whole = carry_out(Device("usb", "1-1", env={"DEVTYPE": "usb_device"}, attributes=chip), RULES)
    assert whole.env["ID_MM_DEVICE_IGNORE"] == "1"


def test_an_adapter_without_a_serial_number_has_no_name_of_ours_but_its_group() -> None:
    nameless = carry_out(tty(serial=""), RULES)
    assert nameless.symlinks == []
    assert nameless.got["GROUP"] == "dialout"


def test_a_device_with_another_chip_is_left_unchanged() -> None:
    other = carry_out(tty(vendor="1a86", product="7523"), RULES)
    assert (other.symlinks, other.got, other.tags) == ([], {}, [])
    modem = Device(
        "usb", "1-2", env={"DEVTYPE": "usb_device"}, attributes={"idVendor": "12d1", "idProduct": "1506"}
    )
    assert "ID_MM_DEVICE_IGNORE" not in carry_out(modem, RULES).env


def test_nothing_is_done_at_an_unplug() -> None:
    gone = carry_out(tty(), RULES, EXAMPLE, action="remove")
    assert (gone.symlinks, gone.got, gone.tags) == ([], {}, [])


def test_a_daemon_is_started_by_the_serial_number_of_one_adapter_alone() -> None:
    assert "SYSTEMD_WANTS" not in carry_out(tty(), RULES).env
    assert carry_out(tty(), RULES, EXAMPLE).env["SYSTEMD_WANTS"] == "twind.service"
    assert "SYSTEMD_WANTS" not in carry_out(tty(serial="FT9999"), RULES, EXAMPLE).env
    commented = re.findall(r"^# (ACTION.*)$", EXAMPLE.read_text(), re.MULTILINE)
    wanting = [line for line in (EXAMPLE.read_text()).splitlines() if "SYSTEMD_WANTS" in line]
    assert len(commented) == 1
    assert len(wanting) == 2
    assert all("ID_SERIAL_SHORT" in line for line in wanting)
