"""Upkeep and scripts find their turn on a bus that leaves no room: real bytes and frames, a fake clock."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from tests.support.can_driver_rig import BITRATE, CanRig
from tests.support.daemon_rig import Rig
from twind import link
from twind.loop.bus.bus_port import PATIENCE, BusPort
from twind.loop.bus.hardware import SPARE, SPARE_SHARE
from twind_drivers.can.can_cycle_budget import budget
from twind_drivers.can.can_models import model
from twind_drivers.slow_read_rate import upkeep_stride

STALE = 0.5  # s: torque is read at least so often however little room there is


@contextmanager
def robot(name: str, rate_hz: float) -> Iterator[Rig]:
    rig = Rig(name, rate_hz=rate_hz)
    try:
        rig.connect()
        yield rig
    finally:
        rig.close()


def oldest(rig: Rig, seconds: float) -> tuple[float, float, int]:
    """The oldest status and fast reading (s) that were seen in so many seconds, and the ticks that passed."""
    status = reading = 0.0
    end = rig.clock.now() + seconds
    ticks = 0
    while rig.clock.now() < end:
        rig.ticks(1)
        ticks += 1
        status = max(status, float((rig.clock.now() - rig.loop.hardware.slow.status_time).max()))
        reading = max(reading, float(rig.loop.robot.measured.age.max()))
    return status, reading, ticks


@pytest.mark.parametrize("late", [0.0, 0.001, 0.0015])
def test_torque_is_read_and_scripts_end_though_every_answer_comes_late(late: float) -> None:
    with robot("h24-mixed", 200.0) as rig:
        for bus in rig.virtual.values():
            bus.faults.delay(late)
        rig.seconds(0.5)
        status, reading, ticks = oldest(rig, 1.5)
        assert status < STALE
        assert reading < 1.0 / 200.0  # everybody was heard in every tick
        assert ticks >= 300 * (1.0 - 2.0 / PATIENCE)
        for spec in rig.robot.buses:
            id = next(joint.id for joint in rig.robot.joints if joint.bus == spec.name)
            begin = rig.clock.now()
            reply = rig.call(link.ReadRegister, bus=spec.name, id=id, name="hardware_error_status")
            assert reply.error is None
            assert rig.clock.now() - begin < 0.2


@pytest.mark.parametrize(
    "models",
    [
        ("RS02",) * 6,
        ("RS02",) * 2,
        ("DM4310",) * 12,
        ("AK80-9", "AK70-10", "RS02"),
        ("DM4310", "RS02", "ODrive"),
    ],
    ids=lambda models: f"{len(models)}-{models[0]}",
)
def test_at_the_highest_rate_that_the_budget_accepts_a_slice_waits_a_few_ticks_and_none_is_late(
    models: tuple[str, ...],
) -> None:
    counts: dict[str, int] = {}
    for name in models:
        counts[model(name).family] = counts.get(model(name).family, 0) + 1
    rate = min(1000.0, 0.999 * budget(counts, BITRATE, 100.0).reachable_hz)
    assert budget(counts, BITRATE, rate).refusal(rate) is None
    rig = CanRig(models, rate_hz=rate)
    rig.positions()
    port = BusPort("arm", "here", lambda _: rig.reader, lambda _: rig.writer, reader=rig.reader)
    period = 1.0 / rate
    waits = []
    waited = 0
    stride = upkeep_stride(rate)
    for tick in range(40 * stride):
        begin = rig.clock.now()
        rig.read(np.zeros(len(models), np.int64))
        end = begin + period - min(SPARE, SPARE_SHARE * period)
        if port.begin_rare(rig.clock.now(), end, begin + period, upkeep=tick % stride == 0):
            rig.wait()
            port.end_rare(rig.clock.now())
            waits.append(waited)
            waited = 0
        else:
            waited += port.due_upkeep is not None
        assert rig.clock.now() <= begin + period, f"tick {tick} ends late"
        rig.clock.sleep_until(begin + period)
    assert waits
    assert max(*waits, waited) <= PATIENCE
