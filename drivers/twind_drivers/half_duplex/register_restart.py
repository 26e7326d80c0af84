"""Restart of one serial servo that has torque and error in registers. Scripts."""

from twind_drivers.bus import DeviceRefused, NoReply, PingRequest, RebootRequest, Script
from twind_drivers.half_duplex.register_reader import RegisterReader
from twind_drivers.half_duplex.serial_reader import SerialReader

BOOT_ATTEMPTS = 300  # pings after a reboot before NoReply: 3 s at 100 Hz; a servo is off the bus some 0.1 s
SILENT = 2  # pings without reply that show a restart without status: one may be lost
ORDERS = 2  # times that a restart is sent until it has an effect: one packet may be lost


def require_unloaded(bus: RegisterReader, id: int, *, shut_down: bool) -> Script[None]:
    """Raise DeviceRefused while torque enable reads on: the device may carry a load; KeyError, NoReply.

    `shut_down`: the device has unloaded by an error, which must read non-zero.
    """
    on = (yield from bus.read(id, "torque_enable")).value
    if on and not (shut_down and (yield from bus.read(id, "hardware_error_status")).value):
        reason = "its torque is on and a restart would drop what it carries: disarm, then reboot"
        raise DeviceRefused(bus.name, id, "reboot", reason)


def reboot(bus: SerialReader | RegisterReader, id: int) -> Script[None]:
    """Restart the device and wait until it is back on the bus. Raises NoReply.

    The status may be lost, or not be sent (status return level 1; Feetech). Then two pings without
    reply show that the device restarts, which takes 0.1 s: two readings at 20 Hz. Else the order was lost.
    """
    waited = 0.0
    for _ in range(ORDERS):
        reply = yield RebootRequest(id)
        bus.slow.forget(id)
        waited += reply.waited
        ordered = id in reply.error
        silent = 0
        while silent < BOOT_ATTEMPTS:
            reply = yield PingRequest(id)
            waited += reply.waited
            if id in reply.data:
                break
            silent += 1
        else:
            raise NoReply(bus.name, (id,), waited, f"{BOOT_ATTEMPTS} pings after a reboot")
        if ordered or silent >= SILENT:
            return
    raise NoReply(bus.name, (id,), waited, "reboot")
