"""`twindctl robot servo`: another id or baud rate for servos on a port that no robot file describes yet."""

import argparse
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from typing import Any

from twind.command_line.verb import DONE, Rejected, UsageError, show
from twind_calibration.calibrating.entry_writer import agreed, require_terminal
from twind_calibration.drafting.scan_source import announce, require_devices, scan_rows
from twind_calibration.scan import LAST_ID
from twind_drivers.bus import PortError
from twind_drivers.servo_tools.family_tools import FamilyTools, ServoLocation, tools_of
from twind_drivers.servo_tools.servo_configurator import (
    TORQUE,
    TORQUE_ON,
    ServoConfigurator,
    open_writable,
)


@dataclass(frozen=True, slots=True)
class LocationChange:
    """One servo, where it answers, and where it is to answer."""

    kind: str  # of its bus
    model: int
    model_name: str
    place: ServoLocation
    home: ServoLocation

    def __str__(self) -> str:
        return f"{self.model_name}, {self.place}: becomes {self.home}"


def relocate(options: argparse.Namespace) -> int:
    """Write the new ids and rates, each read back. Raises Rejected, UsageError."""
    if options.new_id is None and options.baud is None:
        raise UsageError("nothing to change: say --new-id N, --baud RATE or both")
    require_terminal(options)
    announce(options, options.port)
    changes = planned_changes(
        _find_devices(options),
        number=options.id,
        new_id=options.new_id,
        baud=options.baud,
    )
    for change in changes:
        if not options.json:
            print(change)
    if changes and not agreed(options, "write this?"):
        raise Rejected("nothing was written")
    for change in changes:
        try:
            _carry_out(options.port, change)
        except PortError as error:
            raise Rejected(str(error)) from error
    result = [
        {"model": each.model_name, "from": asdict(each.place), "to": asdict(each.home)} for each in changes
    ]
    text = "nothing to change" if not changes else f"{len(changes)} changed, torque off"
    show(options, {"changed": result}, text)
    return DONE


def _find_devices(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return the devices between present and new id; where none answers there, all. Raises Rejected."""
    ends = [each for each in (options.id, options.new_id) if each is not None]
    if options.id is not None and min(ends) >= 0 and max(ends) <= LAST_ID:
        rows, _ = scan_rows(options.port, range(min(ends), max(ends) + 1))
        if any(row.get("id") in ends for row in rows):
            return require_devices(rows, "", options.port)
    return require_devices(*scan_rows(options.port), options.port)


def planned_changes(
    rows: Sequence[Mapping[str, Any]], *, number: int | None, new_id: int | None, baud: int | None
) -> list[LocationChange]:
    """Return the changes of the devices of a scan, the one with id `number` or all; none: all are there.

    Raises Rejected: several devices for one new id, one that cannot be changed, or a place that is taken.
    """
    chosen = [row for row in rows if number in (None, row["id"])]
    if not chosen and new_id is not None:  # its id was written before an interruption, its rate was not
        chosen = [row for row in rows if row["id"] == new_id]
    if not chosen:
        raise Rejected(f"no device has id {number}; there are {_list(rows)}")
    if new_id is not None and len(chosen) > 1:
        raise Rejected(f"{len(chosen)} devices answer: {_list(chosen)}; say --id N, or connect one alone")
    changes = [_change(row, new_id, baud) for row in chosen]
    stay = [_place(row) for row in rows if row not in chosen]
    for at, change in enumerate(changes):
        others = stay + [each.home for each in changes[:at]] + [each.place for each in changes[at + 1 :]]
        for step in (change.home, ServoLocation(change.home.id, change.place.baud)):
            if step in others:
                raise Rejected(f"{change}: another servo is there; say another --new-id, or disconnect it")
    return [change for change in changes if change.place != change.home]


def _change(row: Mapping[str, Any], new_id: int | None, baud: int | None) -> LocationChange:
    place = _place(row)
    if row.get("trouble"):
        raise Rejected(f"{place}: {row['trouble']}")
    tools = tools_of(row["kind"]) if row.get("kind") else None
    if tools is None or not row.get("model_name"):
        raise Rejected(f"{place}: model {row.get('model')}: set it with its maker's tool")
    if row.get("torque"):
        raise Rejected(TORQUE_ON.format(place))
    home = ServoLocation(place.id if new_id is None else new_id, baud or place.baud)
    protocol = tools.protocol
    if not 0 <= home.id <= protocol.last_id:
        raise Rejected(f"--new-id {home.id}: ids of {protocol.kind} are 0 to {protocol.last_id}")
    if home.baud not in protocol.bauds:
        rates = ", ".join(map(str, sorted(protocol.bauds)))
        raise Rejected(f"--baud {home.baud}: {protocol.kind} has {rates}")
    return LocationChange(row["kind"], row["model"], row["model_name"], place, home)


def _carry_out(port: str, change: LocationChange) -> None:
    """Write one change. Raises Rejected, PortError."""
    tools: FamilyTools | None = tools_of(change.kind)
    assert tools is not None  # `_change` lets no other pass
    with ExitStack() as stack:
        at = open_writable(port, tools.protocol, stack)
        table = tools.table_of(change.model_name)
        servo = ServoConfigurator(at, tools, change.model, table, change.place)
        if not servo.is_free(change.home):
            raise Rejected(f"{change}: another servo answers there")
        if servo.read([TORQUE])[TORQUE]:
            raise Rejected(TORQUE_ON.format(change.place))
        with servo.unlocked():
            servo.move(change.home)


def _place(row: Mapping[str, Any]) -> ServoLocation:
    return ServoLocation(int(row["id"]), int(row["baud"]))


def _list(rows: Sequence[Mapping[str, Any]]) -> str:
    return ", ".join(str(_place(row)) for row in rows)
