"""Restart of one serial servo that has torque and error in registers. Scripts."""

from twind_drivers.bus import DeviceRefused, NoReply, PingRequest, RebootRequest, Script
from twind_drivers.half_duplex.register_reader import RegisterReader

BOOT_ATTEMPTS = 300  # pings after a reboot before NoReply: 3 s at 100 Hz


def require_unloaded(bus: RegisterReader, id: int, *, shut_down: bool) -> Script[None]:
    """Raise DeviceRefused while torque enable reads on: the device may carry a load; KeyError, NoReply.

    `shut_down`: the device has unloaded by an error, which must read non-zero.
    """
    on = (yield from bus.read(id, "torque_enable")).value
    if on and not (shut_down and (yield from bus.read(id, "hardware_error_status")).value):
        reason = "its torque is on and a restart would drop what it carries: disarm, then reboot"
        raise DeviceRefused(bus.name, id, "reboot", reason)


def restart(bus: RegisterReader, id: int) -> Script[None]:
    """Restart the device and wait for its reply. Raises NoReply."""
    waited = (yield RebootRequest(id)).waited
    bus.slow.forget(id)
    for _ in range(BOOT_ATTEMPTS):
        reply = yield PingRequest(id)
        waited += reply.waited
        if id in reply.data:
            return
    raise NoReply(bus.name, (id,), waited, f"{BOOT_ATTEMPTS} pings after a reboot")
