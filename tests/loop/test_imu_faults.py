"""An IMU that is late, comes and goes, babbles or talks nonsense costs nobody anything: the whole daemon,
arming or with a motion under way; a fake clock."""

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.support.imu_rig import Standing
from twind import link
from twind.loop.bus.imu_poller import HARMS, SILENT, TARDY
from twind.robot.modes import Mode
from twind_drivers.dynamixel.packet import status

Order = Callable[[Any, int], None]  # faults of the bus, tick


def late(seconds: float, every: int = 1) -> Order:
    return lambda faults, tick: faults.delay(0.0 if tick % every else seconds, 200)


def lost(faults: Any, tick: int) -> None:
    if tick % 2:
        faults.drop(1, 200)


def tardy_nonsense(faults: Any, tick: int) -> None:
    faults.delay(0.004, 200)
    faults.corrupt(1, 200, bits=40)


WRONG: dict[str, Order] = {
    "always 4 ms late": late(0.004),
    "always 8.5 ms late": late(0.0085),
    "always 12 ms late": late(0.012),
    "every other 9.5 ms late": late(0.0095, 2),
    "every 5th 3 ms late": late(0.003, 5),
    "every 10th 8.5 ms late": late(0.0085, 10),
    "every other lost": lost,
    "nonsense": lambda faults, tick: faults.corrupt(1, 200, bits=40),
    "nonsense, late": tardy_nonsense,
}


def suffered(rig: Any, order: Order, ticks: int) -> Counter[str]:
    """Count the damage to the servos' readings, tick by tick; the motion must go on."""
    found: Counter[str] = Counter()
    hardware = rig.loop.hardware
    motion = rig.loop.executor.motion
    errors = hardware.ports[0].counts.errors
    for tick in range(ticks):
        order(rig.virtual["main"].faults, tick)
        if not tick % 20:
            rig.send(link.RenewLease)
        rig.ticks(1)
        found["bad"] += hardware.last_exchange.traffic[0].bad
        found["unheard"] += int((~rig.loop.robot.measured.heard).sum())
        found["stopped"] += rig.loop.executor.motion is not motion
    found["errors"] = hardware.ports[0].counts.errors - errors
    found["told"] = sum(event.code in ("BUS_ERRORS", "RX_SHAPE", "FOREIGN_TRAFFIC") for event in rig.events())
    return +found


@pytest.fixture
def rig() -> Iterator[Standing]:
    made = Standing(Mode.LIVE)
    yield made
    made.close()


def move(rig: Standing) -> None:
    rig.arm()
    rig.lease()
    rig.submit(rig.path("head_yaw", [0.0, 0.3, 0.0], [0.5, 4.0, 8.0]))
    rig.ticks(60)


@pytest.mark.parametrize("wrong", WRONG)
def test_no_servo_loses_a_reading_and_the_motion_goes_on(wrong: str, rig: Standing) -> None:
    move(rig)
    assert suffered(rig, WRONG[wrong], 300) == {}
    assert rig.loop.hardware.inertial.missed > 0, "nothing was wrong: this shows nothing"
    said = [event.message for event in rig.events() if event.code == "PORT_WARNING"]
    assert said and all("imu (id 200)" in each for each in said)
    assert any(each in rig.loop.hardware.ports[0].warning for each in (SILENT, TARDY, HARMS))


def test_an_imu_with_unsolicited_packets_disturbs_no_reading(rig: Standing) -> None:
    """Between the readings, and in the middle of the servos' joint answer."""
    move(rig)
    bus = rig.virtual["main"]
    said = status(200, 0, bytes(12))

    def babble(faults: Any, tick: int) -> None:
        bus.wire.interject(rig.next_tick + 0.0002 + 0.0001 * (tick % 90), said)

    assert suffered(rig, babble, 270) == {}
    assert rig.loop.hardware.inertial.late > 200


@pytest.mark.parametrize("wrong", ["every 5th 3 ms late", "every 10th 8.5 ms late", "always 8.5 ms late"])
def test_a_faulty_imu_does_not_prevent_arming(wrong: str, rig: Standing) -> None:
    rig.connect()
    for tick in range(100):
        WRONG[wrong](rig.virtual["main"].faults, tick)
        rig.ticks(1)
    rig.call(link.AcquireLease)
    assert rig.call(link.Arm).error is None


@pytest.mark.parametrize("delay", [0.0085, 0.0095])
@pytest.mark.parametrize("every", [1, 2, 20])
def test_an_imu_that_collides_with_servo_replies_costs_very_few_readings(
    delay: float,
    every: int,
    rig: Standing,
) -> None:
    """On a wire where two that talk at once garble each other: parked at once, for longer each time; and it
    is the IMU that is told, not the bus."""
    move(rig)
    rig.virtual["main"].faults.collide()
    found = suffered(rig, late(delay, every), 300)
    readings = found.pop("unheard", 0)
    assert 0 < readings <= 24 * 8, "of 7200"
    assert found == {}
    assert rig.loop.hardware.inertial.spoilt <= 8
    assert HARMS in rig.loop.hardware.ports[0].warning


def test_a_bus_that_is_bad_by_itself_is_not_excused_by_an_imu_that_is_silent(
    rig: Standing,
) -> None:
    move(rig)
    rig.virtual["main"].faults.silence(200)
    assert suffered(rig, lambda faults, tick: None, 100) == {}
    found = suffered(rig, lambda faults, tick: faults.corrupt(tick % 2, 5), 100)
    assert found["bad"] >= 40 and found["errors"] >= 40 and found["told"] and found["stopped"]
    assert rig.loop.hardware.inertial.spoilt <= 3


def test_a_recovered_imu_clears_its_warning(rig: Standing) -> None:
    move(rig)
    suffered(rig, WRONG["always 4 ms late"], 100)
    assert rig.loop.hardware.ports[0].warning
    rig.virtual["main"].faults.delay(0.0, 200)
    rig.seconds(8.0)
    assert not rig.loop.hardware.ports[0].warning
    assert rig.loop.robot.measured.time - rig.imu.time < 0.02
