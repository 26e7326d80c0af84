"""Procedures for commands on single devices: read and write a register, reboot, scan.

Torque is not changed.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import TYPE_CHECKING, Any, TypeVar

from twind import link
from twind.exceptions import InvalidInput
from twind.loop.procedures.procedure_runner import Procedure, all_of
from twind.robot.event_codes import EventCode
from twind.robot.modes import Mode
from twind_drivers.bus import BusError, NoReply, RegisterAddress, RestartResult

if TYPE_CHECKING:
    from twind.loop.bus.bus_port import BusPort, ScriptRun
    from twind.loop.tick.control_loop import Loop


T = TypeVar("T")


def _port(loop: Loop, command: link.Command, name: str | None, id: int | None = None) -> BusPort | None:
    """Return the open port of a bus; None after an error reply."""
    names = [port.name for port in loop.hardware.ports]
    for port in loop.hardware.ports:
        if port.name == name or (name is None and len(names) == 1):
            if port.reader is None:
                loop.say.error(
                    command, "BusFailed", bus=port.name, message=port.trouble or "the bus is not open"
                )
                return None
            if id is not None and id not in port.reader.ids:
                ids = [str(each) for each in port.reader.ids]
                loop.say.error(command, "NotFound", what=f"id on bus {port.name}", name=str(id), known=ids)
                return None
            if port.full or loop.procedures.rank is not None:
                loop.say.error(command, "Busy", what=f"bus {port.name}")
                return None
            return port
    loop.say.error(command, "NotFound", what="bus", name=name or "", known=names)
    return None


def _writable(
    loop: Loop,
    command: link.WriteRegister | link.Reboot,
    port: BusPort,
    what: str,
    *,
    unknown: bool = False,
) -> bool:
    """Check for mode live, no torque, and no end-stop search that still restores the device.

    `unknown`: the torque of other devices need not be known. False after an error reply.
    """
    if loop.mode is not Mode.LIVE or port.writer is None:
        loop.say.error(
            command, "WrongState", state=f"mode {loop.mode.value}", allowed=[f"mode live, to {what}"]
        )
        return False
    if given_back := loop.homing.busy(port.name, command.id):
        loop.say.error(command, "Busy", what=given_back)
        return False
    on = loop.torque_on or bool((loop.hardware.slow.torque[loop.hardware.open] == 1).any())
    if on or (loop.energised and not unknown):
        _refuse(loop, command, "torque on" if on else "torque not read yet")
        return False
    return True


def _refuse(loop: Loop, command: link.Command, torque: str) -> None:
    loop.say.error(command, "WrongState", state=f"{loop.state.value}, {torque}", allowed=["disarmed"])


def _answer(
    loop: Loop,
    command: link.Command,
    port: BusPort,
    task: ScriptRun[T],
    render: Callable[[T], dict[str, Any]],
    name: str = "",
) -> Procedure:
    """Wait for the task, then reply with `render` of its result, or with the error."""
    try:
        yield from all_of([task])
    except (InvalidInput, KeyError) as error:
        near = error.near if isinstance(error, InvalidInput) else ()
        loop.say.error(command, "NotFound", what="register", name=name, known=list(near))
    except (BusError, ValueError) as error:
        loop.say.error(command, "BusFailed", bus=port.name, message=str(error))
    else:
        assert task.result is not None
        loop.say.reply(command, **render(task.result))


def _register(value: RegisterAddress) -> dict[str, Any]:
    plain = {"name": value.name, "address": value.address, "size": value.size, "value": value.value}
    return {"register": plain}


def _restored(restart: RestartResult) -> dict[str, Any]:
    """Return texts on the settings that the restart changed and that were restored, and those that differ."""
    return {
        "restored": [f"{each.name} = {each.value}" for each in restart.restored],
        "differing": [f"{each.name} is {each.value}, was {was}" for each, was in restart.differing],
    }


def read(loop: Loop, command: link.ReadRegister, now: float) -> None:
    """Read one register of one device, in mode mirror and live."""
    port = _port(loop, command, command.bus, command.id)
    if port is not None and port.reader is not None:
        task = port.run(port.reader.read(command.id, command.name))
        loop.procedures.beside(_answer(loop, command, port, task, _register, command.name))


def write(loop: Loop, command: link.WriteRegister, now: float) -> None:
    """Write one register and read it back.

    On a bus that is not identified the torque may be unknown; then the torque of this device is read first. A
    register can be what prevents identification (a long return delay).
    """
    port = _port(loop, command, command.bus, command.id)
    if port is None or not _writable(loop, command, port, "write a register", unknown=True):
        return
    if loop.calibrating.may_keep(command, _is_eeprom(port, command), now):
        loop.procedures.beside(_write_register(loop, command, port))


def _is_eeprom(port: BusPort, command: link.WriteRegister) -> bool:
    """True where that register survives power-off.

    False for an unknown register: the write itself reports it.
    """
    try:
        return port.reader is not None and port.reader.keeps(command.id, command.name)
    except (InvalidInput, KeyError):
        return False


def _write_register(loop: Loop, command: link.WriteRegister, port: BusPort) -> Procedure:
    if loop.energised and not (yield from _limp(port, command.id)):
        _refuse(loop, command, f"torque of id {command.id} on or not read")
        return
    if loop.procedures.rank is not None:
        loop.say.error(command, "Busy", what=f"bus {port.name}")
        return
    if not _writable(loop, command, port, "write a register", unknown=True) or port.writer is None:
        return
    if _is_eeprom(port, command) and not loop.calibrating.on:  # calibrating ended while the torque was read
        loop.calibrating.refuse(command)
        return
    task: ScriptRun[RegisterAddress] = port.run(port.writer.write(command.id, command.name, command.value))
    yield from _answer(loop, command, port, task, _register, command.name)
    done = "was refused" if task.error is not None else "is written"
    message = f"{command.holder}: {port.name}/{command.id} {command.name} := {command.value} {done}"
    loop.say.event("info", EventCode.REGISTER, message)
    if task.result is not None and task.result.eeprom:
        port.identify()  # the device may no longer match the robot file, which identification reports at once


def _limp(port: BusPort, id: int) -> Generator[None, float, bool]:
    """True where the torque of the device reads off now."""
    if port.reader is None:
        return False
    task = port.run(port.reader.read(id, "torque_enable"))
    try:
        yield from all_of([task])
    except (BusError, KeyError, ValueError):
        return False
    return task.result is not None and task.result.value == 0


def reboot(loop: Loop, command: link.Reboot, now: float) -> None:
    """Restart one device, restore its RAM settings, and identify all devices again."""
    port = _port(loop, command, command.bus, command.id)
    if port is None or not _writable(loop, command, port, "reboot a device") or port.writer is None:
        return
    task = port.run(port.writer.reboot(command.id))
    loop.procedures.beside(_reboot(loop, command, port, task))


def _reboot(loop: Loop, command: link.Reboot, port: BusPort, task: ScriptRun[RestartResult]) -> Procedure:
    yield from _answer(
        loop, command, port, task, lambda restart: {"state": loop.state.value, **_restored(restart)}
    )
    if task.result is None:
        return
    changes = _restored(task.result)
    words = [f"{what} {', '.join(each)}" for what, each in changes.items() if each]
    level = "warning" if task.result.differing else "info"
    message = (
        f"{command.holder}: {port.name}/{command.id} restarted; {'; '.join(words) or 'nothing to restore'}"
    )
    loop.say.event(level, EventCode.REBOOT, message)
    port.identify()


def scan(loop: Loop, command: link.Scan, now: float) -> None:
    """Scan a bus for the ids that the robot file names. One reply per device that answers."""
    port = _port(loop, command, command.bus)
    if port is not None:
        loop.procedures.beside(_scan(loop, command, port))


def _scan(loop: Loop, command: link.Scan, port: BusPort) -> Procedure:
    assert port.reader is not None
    task = port.run(port.reader.identify())
    try:
        yield from all_of([task])
    except BusError as error:
        loop.say.error(command, "BusFailed", bus=port.name, message=str(error))
        return
    found = list(task.result or ())
    if not found:
        why = NoReply(port.name, port.reader.ids, 0.0, "ping") if port.reader else port.trouble
        silent = port.reader is not None
        loop.say.error(command, "BusFailed", bus=port.name, message=str(why), silent=silent)
        return
    for device in found:
        loop.say.reply(
            command,
            continues=device is not found[-1],
            bus=port.name,
            id=device.id,
            model=device.model_number,
            model_name=device.model_name,
            firmware=device.firmware,
            settings=dict(device.settings),
            unique_id=device.unique_id,
        )
