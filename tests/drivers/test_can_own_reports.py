"""Reports that an ODrive sends by itself: no traffic of another master, whenever they come."""

import numpy as np
import pytest

from tests.support.can_frame_rig import DM, OD, PERIOD, Reading, dm, estimates
from twind_drivers.bus import ReadRequest
from twind_drivers.ports.frame import REMOTE, Frames, frames

IQ, VOLTS = 0x14, 0x17
REPORTS = (0x03, 0x0A, IQ, 0x15, VOLTS, 0x1C, 0x1D)


def report(command: int, id: int = 2) -> Frames:
    return frames([id << 5 | command], np.zeros((1, 8), np.uint8))


@pytest.mark.parametrize("command", REPORTS)
@pytest.mark.parametrize("models", [(OD, OD), (DM, OD)])
def test_a_report_is_not_foreign_in_a_reading_and_between_two(command: int, models: tuple[str, str]) -> None:
    rig = Reading(*models)
    first = estimates(1) if models[0] == OD else dm(1)
    for step in range(3):
        sample = rig.cycle(step * PERIOD, first, estimates(2), report(command))
        assert sample.heard.all()
        assert sample.foreign == 0
        rig.wire.coming.append(report(command))
    assert rig.cycle(3 * PERIOD, first, estimates(2)).foreign == 0


def test_a_report_that_answers_a_read_beside_another_is_not_foreign() -> None:
    rig = Reading(OD)
    rig.cycle(0.0, estimates(1))
    reply = rig.rare(ReadRequest((1,), VOLTS, 4), PERIOD / 2, report(IQ, 1), report(VOLTS, 1))
    assert reply.data == {1: bytes(4)}
    assert rig.cycle(PERIOD, estimates(1)).foreign == 0


@pytest.mark.parametrize(
    "other", [report(0x0C), report(0x07), frames([2 << 5 | 0x09 | REMOTE]), report(0x15, 3)], ids=range(4)
)
def test_a_command_or_request_of_another_master_or_the_report_of_an_unknown_node_stays_foreign(
    other: Frames,
) -> None:
    rig = Reading(OD, OD)
    assert rig.cycle(0.0, estimates(1), estimates(2), other).foreign == 1
    rig.wire.coming.append(other)
    assert rig.cycle(PERIOD, estimates(1), estimates(2)).foreign == 1


def test_a_register_value_of_an_actuator_that_reports_nothing_by_itself_stays_foreign() -> None:
    rig = Reading(DM)
    value = frames([0x11], np.frombuffer(bytes([1, 0, 0x33, 21, 0, 0, 0x48, 0x41]), np.uint8)[None])
    rig.cycle(0.0, dm(1))
    rig.wire.coming.append(value)
    assert rig.cycle(PERIOD, dm(1)).foreign == 1
