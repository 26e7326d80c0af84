"""Writing to a servo on the free port: who has the port, and who answers, is looked at again before it."""

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from tests.support.doctor_robot import BAUD, Ground, Vendor, upper_body
from tests.support.processes import robot
from twind.command_line.verb import Rejected
from twind.config.robot_file import load_robot
from twind.doctor.check_context import CheckContext
from twind.doctor.host_inspector import HostInspector
from twind.exceptions import OperationFailed
from twind_drivers.clock import MonotonicClock
from twind_drivers.dynamixel.dynamixel_tools import TOOLS
from twind_drivers.servo_tools.doctor import register_fix
from twind_drivers.servo_tools.doctor.serial_bus_inspector import SerialBusInspector
from twind_drivers.servo_tools.doctor.serial_bus_survey import expected_servos, survey_port

HOLD = "import os,sys; fd=os.open(sys.argv[1],os.O_RDWR|os.O_NOCTTY); print(flush=True); sys.stdin.read()"
MASK = (63, 37)  # shutdown (e-manual): without electrical shock


@pytest.fixture(scope="module")
def ground(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ground]:
    file = upper_body(tmp_path_factory.mktemp("mended"))
    with robot(str(file), "--muscles", "first-order") as (virtual, _):
        yield Ground(virtual)


@pytest.fixture
def fix(ground: Ground) -> Iterator[Any]:
    """Writes 53 into the mask of servo 1, as it was found when it was looked at."""
    with Vendor(ground.port) as vendor:
        ground.set(vendor, 1, *MASK)
    spec = load_robot(ground.virtual.robot)
    line = SerialBusInspector(ground.port, BAUD, HostInspector(), MonotonicClock(), TOOLS)
    seen = CheckContext(HostInspector(), "twind.service", robot=spec, lines={"main": line})
    seen.surveys["main"] = survey_port(line, spec.buses[0], spec, range(13))
    seen.close()
    found = next(servo for _, servo in expected_servos(seen) if servo.id == 1)

    def write(**otherwise: int) -> None:
        wanted = register_fix.offer_fix(seen, replace(found, **otherwise), "shutdown", 53)  # type: ignore[arg-type]
        assert wanted is not None
        wanted.do()

    yield write
    with Vendor(ground.port) as vendor:
        ground.restore(vendor)


def mask(ground: Ground) -> int:
    with Vendor(ground.port) as vendor:
        return vendor.read(1, MASK[0])


def test_the_servo_that_was_found_is_mended(ground: Ground, fix: Any) -> None:
    fix()
    assert mask(ground) == 53


@pytest.mark.parametrize("was", [{"model": 1120}, {"firmware": 46}], ids=["model", "firmware"])
def test_another_servo_at_that_id_by_now_is_left_alone(ground: Ground, fix: Any, was: dict[str, int]) -> None:
    with pytest.raises(Rejected, match=r"another servo is there by now .*nothing was written"):
        fix(**was)
    assert mask(ground) == MASK[1]


def test_a_servo_gone_before_its_fix_is_reported_and_not_written(ground: Ground, fix: Any) -> None:
    ground.virtual.order(fault="silence", id=1)
    try:
        with pytest.raises(Rejected, match="does not answer any more: nothing was written"):
            fix()
    finally:
        ground.virtual.order(fault="clear")
    assert mask(ground) == MASK[1]


def test_a_port_taken_before_the_fix_is_not_written(ground: Ground, fix: Any) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, ground.port], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdin is not None
        holder.stdout.readline()
        with pytest.raises(OperationFailed, match=f"held by pid {holder.pid}"):
            fix()
        holder.stdin.close()
    assert mask(ground) == MASK[1]
