"""Procedures for commands on single devices: read and write a register, reboot, scan.

Torque is not changed.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any, TypeVar

from twind import link
from twind.exceptions import InvalidInput
from twind.loop.bus.bus_port import BusPort
from twind.loop.bus.bus_wait import all_of
from twind.loop.bus.script_run import ScriptRun
from twind.loop.ipc.call_outcome import CallFailure, CallOutcome, CallReply
from twind.loop.procedures.calibrating_state import CalibratingState
from twind.loop.procedures.homing_procedure import HomingProcedure
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Procedure
from twind.loop.procedures.torque_readback import torque_on, torque_possible
from twind.robot.event_codes import EventCode
from twind.robot.modes import Mode
from twind_drivers.bus import BusError, DeviceRefused, NoReply
from twind_drivers.device_registers import RegisterAddress, RestartResult

T = TypeVar("T")


class DeviceCommands:
    """Calls on one device or bus. Each is checked, then runs beside the tick until the bus has served it."""

    def __init__(
        self, context: ProcedureContext, homing: HomingProcedure, calibrating: CalibratingState
    ) -> None:
        self._context = context
        self._homing = homing
        self._calibrating = calibrating

    def read(self, command: link.ReadRegister, now: float) -> None:
        """Read one register of one device, in mode mirror and live."""
        self._begin(command, self._read(command))

    def write(self, command: link.WriteRegister, now: float) -> None:
        """Write one register and read it back.

        On a bus that is not identified the torque may be unknown; then the torque of this device is read
        first. A register can be what prevents identification (a long return delay).
        """
        self._begin(command, self._write(command, now))

    def reboot(self, command: link.Reboot, now: float) -> None:
        """Restart one device, restore its RAM settings, and identify all devices again."""
        self._begin(command, self._reboot(command))

    def scan(self, command: link.Scan, now: float) -> None:
        """Scan a bus for the ids that the robot file names. One reply per device that answers."""
        self._begin(command, self._scan(command))

    def _begin(self, command: link.Command, body: Procedure) -> None:
        """Run a procedure beside the others and send its outcome."""

        def answer(outcome: CallOutcome | None) -> None:
            assert outcome is not None  # each of these calls has one
            self._context.reports.answer(command, outcome)

        self._context.procedures.beside(body, answer)

    # ------------------------------------------------------------------------------- the procedures

    def _read(self, command: link.ReadRegister) -> Procedure:
        port = self._port(command.bus, command.id)
        if isinstance(port, CallFailure):
            return port
        assert port.reader is not None  # `_port` has checked it
        task = port.run(port.reader.read(command.id, command.name))
        return (yield from _outcome(port, task, _register, command.name))

    def _write(self, command: link.WriteRegister, now: float) -> Procedure:
        context = self._context
        port = self._port(command.bus, command.id)
        if isinstance(port, CallFailure):
            return port
        if (denied := self._denied(command, port, "write a register", unknown=True)) is not None:
            return denied
        kept = _is_eeprom(port, command)
        if (denied_here := self._calibrating.refusal_to_keep(command, kept, now)) is not None:
            return denied_here
        if torque_possible(context) and not (yield from _limp(port, command.id)):
            return self._with_torque(f"torque of id {command.id} on or not read")
        if context.procedures.rank is not None:
            return CallFailure("Busy", {"what": f"bus {port.name}"})
        if (denied := self._denied(command, port, "write a register", unknown=True)) is not None:
            return denied
        if kept and not self._calibrating.on:  # ended while the torque was read
            return self._calibrating.not_calibrating(command)
        assert port.writer is not None  # `_denied` has checked it
        task: ScriptRun[RegisterAddress] = port.run(
            port.writer.write(command.id, command.name, command.value)
        )
        outcome = yield from _outcome(port, task, _register, command.name)
        refused = isinstance(task.error, DeviceRefused | ValueError | KeyError)
        done = "is written" if task.error is None else "was refused" if refused else "is not confirmed"
        message = f"{command.holder}: {port.name}/{command.id} {command.name} := {command.value} {done}"
        context.reports.event("info", EventCode.REGISTER, message)
        unsure = isinstance(task.error, NoReply) or (kept and isinstance(task.error, BusError))
        if unsure or (task.result is not None and task.result.eeprom):
            # the device may no longer match the robot file, which identification reports at once
            port.identify()
        return outcome

    def _reboot(self, command: link.Reboot) -> Procedure:
        context = self._context
        port = self._port(command.bus, command.id)
        if isinstance(port, CallFailure):
            return port
        if (denied := self._denied(command, port, "reboot a device")) is not None:
            return denied
        assert port.writer is not None  # `_denied` has checked it
        task = port.run(port.writer.reboot(command.id))
        outcome = yield from _outcome(port, task, self._rebooted)
        if task.result is None:
            return outcome
        changes = _restored(task.result)
        words = [f"{what} {', '.join(each)}" for what, each in changes.items() if each]
        level = "warning" if task.result.differing else "info"
        restored = "; ".join(words) or "nothing to restore"
        message = f"{command.holder}: {port.name}/{command.id} restarted; {restored}"
        context.reports.event(level, EventCode.REBOOT, message)
        port.identify()
        return outcome

    def _scan(self, command: link.Scan) -> Procedure:
        port = self._port(command.bus)
        if isinstance(port, CallFailure):
            return port
        assert port.reader is not None  # `_port` has checked it
        task = port.run(port.reader.identify())
        try:
            yield from all_of([task])
        except (BusError, KeyError, ValueError) as error:
            return CallFailure("BusFailed", {"bus": port.name, "message": str(error)})
        assert task.result is not None
        if not task.result:
            why = NoReply(port.name, port.reader.ids, 0.0, "ping") if port.reader else port.trouble
            silent = port.reader is not None
            return CallFailure("BusFailed", {"bus": port.name, "message": str(why), "silent": silent})
        replies = [
            {
                "bus": port.name,
                "id": device.id,
                "model": device.model_number,
                "model_name": device.model_name,
                "firmware": device.firmware,
                "settings": dict(device.settings),
                "unique_id": device.unique_id,
            }
            for device in task.result
        ]
        for parameters in replies[:-1]:
            self._context.reports.reply(command, continues=True, **parameters)
        return CallReply(replies[-1])

    # ------------------------------------------------------------------------------- what denies it

    def _port(self, name: str | None, id: int | None = None) -> BusPort | CallFailure:
        """Return the open port of a bus, or why there is none."""
        ports = {port.name: port for port in self._context.hardware.ports}
        port = ports.get(name) if name is not None else None
        if name is None and len(ports) == 1:
            port = next(iter(ports.values()))
        if port is None:
            return CallFailure("NotFound", {"what": "bus", "name": name or "", "known": list(ports)})
        if port.reader is None:
            message = port.trouble or "the bus is not open"
            return CallFailure("BusFailed", {"bus": port.name, "message": message})
        if id is not None and id not in port.reader.ids:
            known = [str(each) for each in port.reader.ids]
            what = f"id on bus {port.name}"
            return CallFailure("NotFound", {"what": what, "name": str(id), "known": known})
        if port.full or self._context.procedures.rank is not None:
            return CallFailure("Busy", {"what": f"bus {port.name}"})
        return port

    def _denied(
        self, command: link.WriteRegister | link.Reboot, port: BusPort, what: str, *, unknown: bool = False
    ) -> CallFailure | None:
        """Require mode live, no torque, and no end-stop search that still restores the device.

        `unknown`: the torque of other devices need not be known. None: nothing denies it.
        """
        context = self._context
        if context.condition.mode is not Mode.LIVE or port.writer is None:
            state = f"mode {context.condition.mode.value}"
            return CallFailure("WrongState", {"state": state, "allowed": [f"mode live, to {what}"]})
        if given_back := self._homing.busy(port.name, command.id):
            return CallFailure("Busy", {"what": given_back})
        on = torque_on(context) or bool((context.hardware.slow.torque[context.hardware.open] == 1).any())
        if on or (torque_possible(context) and not unknown):
            return self._with_torque("torque on" if on else "torque not read yet")
        return None

    def _with_torque(self, torque: str) -> CallFailure:
        state = f"{self._context.condition.state.value}, {torque}"
        return CallFailure("WrongState", {"state": state, "allowed": ["disarmed"]})

    def _rebooted(self, restart: RestartResult) -> dict[str, Any]:
        return {"state": self._context.condition.state.value, **_restored(restart)}


def _outcome(
    port: BusPort, task: ScriptRun[T], render: Callable[[T], dict[str, Any]], name: str = ""
) -> Generator[None, float, CallOutcome]:
    """Wait for the task; return `render` of its result, or the error."""
    try:
        yield from all_of([task])
    except (InvalidInput, KeyError) as error:
        near = list(error.near) if isinstance(error, InvalidInput) else []
        return CallFailure("NotFound", {"what": "register", "name": name, "known": near})
    except (BusError, ValueError) as error:
        return CallFailure("BusFailed", {"bus": port.name, "message": str(error)})
    assert task.result is not None
    return CallReply(render(task.result))


def _register(value: RegisterAddress) -> dict[str, Any]:
    plain = {"name": value.name, "address": value.address, "size": value.size, "value": value.value}
    return {"register": plain}


def _restored(restart: RestartResult) -> dict[str, Any]:
    """Return texts on the settings that the restart changed and that were restored, and those that differ."""
    return {
        "restored": [f"{each.name} = {each.value}" for each in restart.restored],
        "differing": [f"{each.name} is {each.value}, was {was}" for each, was in restart.differing],
    }


def _is_eeprom(port: BusPort, command: link.WriteRegister) -> bool:
    """True where that register survives power-off.

    False for an unknown register: the write itself reports it.
    """
    assert port.reader is not None  # the caller has checked it
    try:
        return port.reader.keeps(command.id, command.name)
    except (InvalidInput, KeyError):
        return False


def _limp(port: BusPort, id: int) -> Generator[None, float, bool]:
    """True where the torque of the device reads off now."""
    assert port.reader is not None  # the caller has checked it
    task = port.run(port.reader.read(id, "torque_enable"))
    try:
        yield from all_of([task])
    except (BusError, KeyError, ValueError):
        return False
    return task.result is not None and task.result.value == 0
