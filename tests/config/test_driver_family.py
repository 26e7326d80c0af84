"""A driver family is found by its entry point; one of another package needs no change of this one."""

import os
from collections.abc import Iterator
from dataclasses import fields, replace
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from twind.config import driver_family
from twind.config.config_reader import ConfigReader
from twind.config.cycle_budget import budgets
from twind.config.driver_family import BusDriver, FamilyPart, families, family, family_of, kinds, registered
from twind.config.robot_file import load_robot, read_robot
from twind.config.robot_spec import BusSpec
from twind.doctor.family_doctor import FamilyDoctor
from twind.exceptions import InvalidInput
from twind.loop.bus.bus_opener import BusOpener
from twind.twin.binding import bind
from twind.virtual.virtual_twin import VirtualTwin
from twind_drivers.dynamixel.dynamixel_bus import DRIVER as SERVOS
from twind_drivers.dynamixel.dynamixel_family import DYNAMIXEL
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.servo_keys import servo_type
from twind_drivers.dynamixel.servo_type import ServoType

H24 = load_robot("h24")


class ToyType(ServoType):
    """Device type of the family of another package."""

    BUS = "toy"


class ToyReader(DynamixelReader):
    """Reader of the family of another package."""


def toy_bus(name: str, section: ConfigReader) -> BusSpec:
    return replace(DYNAMIXEL.read_bus(name, section), kind="toy")


def toy_type(name: str, section: ConfigReader) -> ToyType:
    servo = servo_type(name, section)
    return ToyType(**{each.name: getattr(servo, each.name) for each in fields(servo)})


def toy_reader(setup, port):  # type: ignore[no-untyped-def]
    reader = SERVOS.reader(setup, port)
    reader.__class__ = ToyReader
    return reader


TOY_DRIVER = BusDriver(toy_reader, SERVOS.writer)
TOY = replace(
    DYNAMIXEL, kind="toy", read_bus=toy_bus, read_type=toy_type, driver=FamilyPart(f"{__name__}:TOY_DRIVER")
)


@pytest.fixture
def entries(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[tuple[str, str]]]:
    """The families installed beside those of this package: name and place of each entry point."""
    added: list[tuple[str, str]] = []
    own = [(point.name, point.value) for point in registered().values()]

    def found(group: str) -> list[EntryPoint]:
        return [EntryPoint(name, value, group) for name, value in own + added]

    monkeypatch.setattr(driver_family, "entry_points", found)
    for each in (registered, family):
        each.cache_clear()
    yield added
    for each in (registered, family):
        each.cache_clear()


def test_every_part_of_every_installed_family_loads() -> None:
    assert {"can", "dynamixel2"} <= set(kinds())
    for each in families():
        assert isinstance(each.driver.load(), BusDriver)
        assert isinstance(each.virtual.load(), VirtualTwin)
        assert each.doctor is None or isinstance(each.doctor.load(), FamilyDoctor)
        assert all(part is None or callable(part.load()) for part in (each.scan, each.adopt))
        assert each.models()
        assert all(each.knows(name) for name in each.models())


def test_a_family_of_another_package_reads_its_types_and_drives_its_bus(
    entries: list[tuple[str, str]], tmp_path: Path
) -> None:
    entries.append(("toy", f"{__name__}:TOY"))
    text = H24.path.read_text().replace("kind: dynamixel2", "kind: toy")
    file = tmp_path / "toy.yaml"
    file.write_text(text.replace("mjcf: ", f"mjcf: {H24.path.parent}/"))
    robot = read_robot(file)
    assert {joint.type.BUS for joint in robot.joints} == {"toy"}
    assert [each.lines for each in budgets(robot, 100.0)] == [each.lines for each in budgets(H24, 100.0)]
    master, slave = os.openpty()
    try:
        opener = BusOpener(robot, bind(robot, None).joint_map, {"main": os.ttyname(slave)}, 100.0)
        reader = opener.open("main")
        reader.transport.close()
    finally:
        os.close(master)
        os.close(slave)
    assert isinstance(reader, ToyReader)


def test_the_driver_is_imported_before_a_bus_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    """An import takes longer than a tick."""
    broken = replace(DYNAMIXEL, driver=FamilyPart("no.such.module:DRIVER"))
    joints = bind(H24, None).joint_map
    monkeypatch.setattr("twind.loop.bus.bus_opener.family", lambda kind: broken)
    with pytest.raises(ModuleNotFoundError):
        BusOpener(H24, joints, {}, 100.0)


def test_a_device_that_two_families_know_is_of_the_one_whose_bus_the_file_has(
    entries: list[tuple[str, str]],
) -> None:
    entries.append(("toy", f"{__name__}:TOY"))
    assert family_of("XM430-W350").kind == "dynamixel2"
    assert family_of("XM430-W350", [family("toy")]).kind == "toy"


@pytest.mark.parametrize(
    ("added", "kind", "words"),
    [
        ([], "toy", "no installed package drives buses of kind 'toy'; installed: can, dynamixel1"),
        ([("toy", "no.such.module:TOY")], "toy", "no.such.module:TOY cannot be imported: No module named"),
        ([("toy", f"{__name__}:NONE")], "toy", "NONE cannot be imported: module .* has no attribute"),
        ([("toys", f"{__name__}:TOY")], "toys", "registered for kind toys, but drives toy"),
        ([("can", f"{__name__}:TOY")], "can", "two installed packages drive buses of kind can"),
    ],
)
def test_a_kind_without_exactly_one_family_is_refused(
    entries: list[tuple[str, str]], added: list[tuple[str, str]], kind: str, words: str
) -> None:
    entries.extend(added)
    with pytest.raises(InvalidInput, match=words):
        family(kind)
