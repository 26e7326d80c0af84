"""Access that a client needs before it may write EEPROM: the lease, then `calibrating`."""

from tests.support.daemon_rig import CLIENT, Rig
from twind import link


def calibrate(rig: Rig, *, client: int = CLIENT) -> None:
    """From here on EEPROM may be written, for as long as the lease is kept."""
    assert rig.call(link.AcquireLease, client=client).error is None
    reply = rig.call(link.Calibrate, client=client, on=True)
    assert (reply.error, reply.parameters) == (None, {"state": "calibrating"}), reply


def calibrated(rig: Rig, *, client: int = CLIENT) -> None:
    """It is over."""
    assert rig.call(link.Calibrate, client=client, on=False).error is None
