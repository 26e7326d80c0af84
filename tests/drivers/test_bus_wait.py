"""Polls while readings come in: no bus is polled for another, and no frame one by one."""

from collections import Counter
from typing import Any

import numpy as np
import pytest

from tests.support.daemon_rig import Rig
from tests.support.two_bus_rig import TwoBuses
from twind_drivers.can.can_reader import CanReader

LEGS = ("l_leg", "r_leg")  # the CAN buses of h24-mixed
AFTER = 0.0003  # s that a whole reading may wait until it is looked at


def counted(reader: Any, looks: Counter[str]) -> None:
    """From now on each look at that bus is counted under its name."""
    feed = reader.feed

    def look(now: float) -> bool:
        looks[reader.name] += 1
        found: bool = feed(now)
        return found

    reader.feed = look


def test_a_bus_that_waits_for_a_servo_is_not_polled_when_the_other_bus_has_data() -> None:
    world = TwoBuses()
    looks = Counter[str]()
    world.connect()
    world.virtual["left"].faults.silence(2)
    for port in world.ports:
        counted(port.reader, looks)
    state = world.tick()
    assert state.heard[1::2].all()
    assert not state.heard[2]
    assert 1 <= looks["right"] <= 2, "its reading, and a turn of upkeep where one is due"
    assert looks["left"] <= 6


class Watched(Rig):
    """Delay from the last frame of each whole CAN reading until it is taken, and the polls it took."""

    def open_port(self, name: str) -> Any:
        reader = super().open_port(name)
        if isinstance(reader, CanReader):
            self._watch(self.virtual[name].controller, reader)
        return reader

    def _watch(self, controller: Any, reader: Any) -> None:
        hear = controller.receive_frame
        finish = reader.finish
        feed = reader.feed
        self.waited: list[float] = []
        self.looks: list[int] = []
        last = 0.0
        looks = 0

        def came(message: Any, now: float) -> None:
            nonlocal last
            last = now
            hear(message, now)

        def look(now: float) -> bool:
            nonlocal looks
            looks += 1
            found: bool = feed(now)
            return found

        def finished(now: float) -> Any:
            nonlocal looks
            sample = finish(now)
            if sample.heard.all():
                self.waited.append(sample.received - last)
                self.looks.append(looks)
            looks = 0
            return sample

        controller.receive_frame = came
        reader.feed = look
        reader.finish = finished


@pytest.mark.slow
def test_a_can_reading_is_taken_in_few_looks_and_soon_after_its_last_frame() -> None:
    rig = Watched("h24-mixed")
    rig.ticks(250)
    rig.waited.clear(), rig.looks.clear()
    rig.ticks(100)
    rig.close()
    assert len(rig.waited) == 100 * len(LEGS)
    assert max(rig.waited) <= AFTER
    # One for the turn of upkeep before it, where there was one.
    assert np.mean(rig.looks) <= 3.0
    assert max(rig.looks) <= 5


@pytest.mark.slow
def test_a_can_reading_returns_to_its_normal_duration_after_a_missing_reply() -> None:
    rig = Watched("h24-mixed")
    rig.ticks(250)
    for _ in range(10):  # each time until it is parked: what is late then says nothing of the wire
        rig.virtual["r_leg"].faults.silence(1)
        rig.ticks(8)
        rig.virtual["r_leg"].faults.clear()
        rig.ticks(12)
    rig.waited.clear()
    rig.ticks(50)
    rig.close()
    assert max(rig.waited) <= AFTER
