"""Units that come and go with an adapter: what udev's rules ask of systemd, told to it without an adapter.

The rules say `SYSTEMD_WANTS`, the drop-in `BindsTo`; PID 1 hears of the device as udevd would tell it.
"""

from collections.abc import Iterator

import pytest

from tests.support.systemd import installed
from tests.support.systemd.machine import Machine
from tests.support.systemd.service import Service, Unit, drop_in, settings

SERIAL = "FT0000"
UNIT = "twind@plugged.service"


@pytest.fixture
def plugged(machine: Machine) -> Iterator[Service]:
    """An instance that nobody started, bound to its adapter by the drop-in of the repository."""
    settings(machine, "plugged", {"mode": "mirror", "robot": "h24"})
    drop_in(machine, UNIT, "bind-to-device.conf")
    machine.inside("/run/udev.py").write_text(
        (installed.REPOSITORY / "tests/support/systemd/udev.py").read_text()
    )
    service = Service(machine, UNIT, "/run/twind/plugged")
    service.reset()
    yield service
    tell(machine, "remove")
    service.stop()


def tell(machine: Machine, action: str) -> None:
    machine.run("python", "-I", "/run/udev.py", action, f"twind/{SERIAL}", UNIT)


def test_plugged_it_starts_unplugged_it_ends_and_replugged_it_starts_again(plugged: Service) -> None:
    machine = plugged.machine
    device = Unit(machine, f"dev-twind-{SERIAL}.device")
    assert (plugged.show("ActiveState"), device.show("ActiveState")) == ("inactive", "inactive")
    for _ in ("plugged", "replugged"):
        tell(machine, "add")
        plugged.until(ActiveState="active")
        assert device.show("ActiveState") == "active"
        tell(machine, "remove")
        plugged.until(ActiveState="inactive")
        assert plugged.show("Result") == "success"


def test_the_names_of_rules_and_drop_in_are_those_of_the_device(machine: Machine) -> None:
    folder = installed.REPOSITORY / "systemd"
    unit = machine.run("systemd-escape", "-p", "--suffix=device", f"/dev/twind/{SERIAL}").strip()
    assert f"BindsTo={unit}" in (folder / "examples/bind-to-device.conf").read_text()
    rules = (folder / "udev/60-twind.rules").read_text()
    assert 'SYMLINK+="twind/$attr{serial}"' in rules and 'TAG+="systemd"' in rules
