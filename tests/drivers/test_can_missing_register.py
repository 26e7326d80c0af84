"""A register that the firmware of an actuator lacks: it says so, and that is no traffic of another master."""

import pytest

from tests.support.can_driver_rig import CanRig
from twind_drivers.bus import NoReply
from twind_drivers.virtual.can import virtual_robstride


def test_the_error_echo_of_a_robstride_is_not_foreign(monkeypatch: pytest.MonkeyPatch) -> None:
    """FOREIGN_TRAFFIC: its watchdog is read 25 times a second, whether its firmware has one or not."""
    monkeypatch.delitem(virtual_robstride.FORMS, virtual_robstride.TIMEOUT)
    rig = CanRig(("RS01", "RS01"), watchdog=False)
    found = rig.identify()
    assert ["timeout" in each.settings for each in found] == [False, False]
    samples = rig.ticks(100)
    assert all(sample.heard.all() for sample in samples[5:])
    assert sum(sample.foreign for sample in samples) == 0
    with pytest.raises(NoReply, match="read of timeout"):
        rig.beside(rig.reader.read(1, "timeout"))
