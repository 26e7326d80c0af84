"""The doctor's advice on supplies, on real ports: servos of 5 V and of 12 V share one bus."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.support.doctor_rig import look as see
from tests.support.doctor_robot import Vendor, upper_body
from tests.support.processes import Virtual, robot, until
from twind.config.robot_file import load_robot
from twind.doctor import report, runner
from twind.doctor.check import DoctorFinding

CODES = ("VOLTAGE_LOW", "VOLTAGE_HIGH", "REGISTER_DIFFERS", "VOLTAGE_DROP")
SMALL = range(1, 6)  # ids of XL330 (5 V); the others are XM430 (12 V)
SLIP = "    device: XM430-W350\n    supply: {warn_v: 15.0, high_v: 16.0}\n"
XL330 = """  xl330:
    device: XL330-M288
    mode: position
    ticks_per_turn: 4096
    return_delay_us: 10
    gains: {p: 400, i: 0, d: 0}
    torque_constant_nm_per_a: 0.3
    current_lsb_a: 0.001
    current_limit_a: 1.4
    velocity_limit_rad_s: 4.0
    acceleration_limit_rad_s2: 20.0
"""


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Virtual]:
    """Five XL330 on 5 V and seven XM430 on 12 V, on one bus."""
    file = upper_body(tmp_path_factory.mktemp("mixed"))
    text = file.read_text().replace("\ndefaults:", f"{XL330}\ndefaults:", 1)
    for id in SMALL:
        text = text.replace(f"{{id: {id},", f"{{id: {id}, type: xl330,", 1)
    file.write_text(text)
    load_robot(str(file))
    with robot(str(file), "--muscles", "first-order") as (virtual, _):
        yield virtual


@pytest.fixture
def mixed(served: Virtual) -> Iterator[Virtual]:
    """The same robot; each test leaves it with all of its voltages back."""
    yield served
    settled(served, {id: 5.0 if id in SMALL else 12.0 for id in range(1, 13)})


@contextmanager
def ordered(virtual: Virtual, *orders: dict[str, Any], healed: dict[str, Any]) -> Iterator[None]:
    """Faults for as long as the block lasts; `healed` takes each of them back."""
    for order in orders:
        virtual.order(**order)
    try:
        yield
    finally:
        for order in orders:
            virtual.order(**{**order, **healed})


def look(virtual: Virtual, *words: str) -> list[DoctorFinding]:
    """Findings of the doctor about supplies, on the free port."""
    (port,) = virtual.ports.values()
    given = ["--robot", virtual.robot, "--port", f"main={port}", *words]
    outcome = see(*given, only=list(CODES))
    assert not outcome.unseen
    return [each for each in outcome.found if each.code in CODES]


def printed(finding: DoctorFinding) -> str:
    """The finding as the doctor prints it."""
    return report.text(runner.DoctorReport(found=[finding]), runner.table(), None)


def test_servos_of_5_v_beside_servos_of_12_v_are_healthy(mixed: Virtual) -> None:
    assert look(mixed) == []


def test_a_servo_below_the_others_is_compared_with_its_own_model(mixed: Virtual) -> None:
    with ordered(mixed, {"fault": "sag", "id": 2, "volts": 0.6}, healed={"volts": 0}):
        settled(mixed, {2: 4.4})
        drop = next(each for each in look(mixed) if each.code == "VOLTAGE_DROP")
    assert drop.measured == "id 2 4.4 V"
    assert drop.expected == "within 0.6 V of the other XL330-M288, which measure 5.0 V"
    said = printed(drop)
    assert "12" not in said
    assert said.index("do not raise the supply") < said.index("do: measure the voltage")


def test_a_model_whose_supply_is_low_gets_the_bounds_of_its_own_range(mixed: Virtual) -> None:
    sags = [{"fault": "sag", "id": id, "volts": 1.0} for id in SMALL]
    with ordered(mixed, *sags, healed={"volts": 0}):
        settled(mixed, dict.fromkeys(SMALL, 4.0))
        (low,) = look(mixed)
    assert (low.code, low.measured) == ("VOLTAGE_LOW", "4.0 V")
    assert low.expected == "above 4.4 V, 6.4 V at most"
    assert "never feed a device above the rated voltage" in printed(low)


def test_a_servo_with_the_right_voltage_is_not_led_to_the_too_high_one_of_the_others(tmp_path: Path) -> None:
    with robot(str(upper_body(tmp_path)), "--muscles", "first-order") as (virtual, _):
        virtual.order(fault="supply", volts=15.5)
        virtual.order(fault="sag", id=9, volts=3.5)
        settled(virtual, {9: 12.0, 8: 15.5})
        found = look(virtual)
    assert {each.code for each in found} == {"VOLTAGE_HIGH"}
    assert not [each for each in found if "id 9" in each.thing]


def test_bounds_that_no_supply_can_meet_are_no_reason_to_raise_it(mixed: Virtual) -> None:
    """A slip in the robot file asks for more than the model bears."""
    file = Path(mixed.robot).with_name("slip.yaml")
    text = Path(mixed.robot).read_text()
    file.write_text(text.replace("    device: XM430-W350\n", SLIP, 1))
    found = look(mixed, "--robot", str(file))
    assert {each.code for each in found} == {"REGISTER_DIFFERS"}
    assert "leave it as it is" in printed(found[0])


def settled(virtual: Virtual, volts: dict[int, float]) -> None:
    """Wait until register 144 of these ids reads these voltages."""
    (port,) = virtual.ports.values()
    with Vendor(port) as vendor:
        for id, wanted in volts.items():
            until(lambda: vendor.read(id, 144, 2) == round(10 * wanted), 5.0, f"id {id}: {wanted} V")  # noqa: B023
