"""Export a flight file or a recording as .mcap.

The raw bus bytes of a flight file become the topic /twind/wire. No file is overwritten. `ros2 bag` cannot
read files with JSON messages: for it, --ros puts them into std_msgs/String.
"""

import argparse
import json
import os
from collections.abc import Iterator
from pathlib import Path

from twind.client.clock_pair import ClockPair
from twind.command_line.progress import ProgressLine
from twind.command_line.verb import DONE, Rejected, show
from twind.exceptions import InvalidInput
from twind.flight import NO_BUS, EntryKind, FlightEntry, LoadedFlight, load
from twind.link import Tick
from twind.observe.recording.flight_monitor_messages import answers, news, wire
from twind.observe.recording.flight_reader import wall_offset
from twind.observe.recording.foreign_content import refuse_foreign_content
from twind.observe.recording.recording_topics import WIRE
from twind.observe.recording.unopened_file import unopened
from twind.observe.recover import recover
from twind.observe.writing.record_encoder import RecordEncoder, RecordLine
from twind.observe.writing.record_file import RecordFile
from twind.observe.writing.record_schemas import attachments, clock_words
from twind.plain_file import open_plain

group = "record"
unused_options = ("--socket",)  # it asks no daemon

_NAMES = {EntryKind.OUT: "out", EntryKind.IN: "in", EntryKind.PORT: "port"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `twindctl export`."""
    parser.add_argument("file", metavar="FILE", type=Path, help="a .flight or an .mcap file")
    parser.add_argument("out", metavar="OUT.mcap", type=Path, help="the file to write")
    parser.add_argument("--ros", action="store_true", help="for `ros2 bag`: JSON as std_msgs/String")


def run(options: argparse.Namespace) -> int:
    """Export; 1 where that file gives nothing."""
    with ProgressLine(options, "export") as progress:
        progress.update(options.file.name)
        messages = export(options.file, options.out, ros=options.ros)
    said = f"{options.out}: {messages} messages"
    show(options, {"file": str(options.file), "out": str(options.out), "messages": messages}, said)
    return DONE


def export(path: Path, out: Path, *, ros: bool = False) -> int:
    """Write `out`, for `ros2 bag` where `ros`; the number of messages in it. Raises Rejected."""
    try:
        with open_plain(path) as file:
            flight = file.read(5) == b"twind"
        with refuse_foreign_content(path):
            return _export_flight(path, out, ros) if flight else _recovered(path, out, ros=ros)
    except InvalidInput as error:
        raise Rejected(str(error)) from None
    except FileExistsError:
        raise Rejected(f"{out}: is there already, and is never written over; name another OUT.mcap") from None
    except OSError as error:
        raise unopened(Path(error.filename or out), error) from None


def _recovered(path: Path, out: Path, *, ros: bool) -> int:
    return recover(path, out, ros=ros, other="OUT.mcap").messages


def _export_flight(path: Path, out: Path, ros: bool) -> int:
    flight = load(path)
    if not flight.contents.entries:
        raise Rejected(f"{path}: nothing was recorded yet")
    clocks = ClockPair(0.0, wall_offset(flight))
    briefing = flight.briefing
    lines = sorted(_lines(flight, clocks), key=lambda line: line.time_ns)
    files = attachments(briefing.description, briefing.calibration, briefing.mjcf)
    if lines[0].time_ns < 0:
        raise ValueError(f"its first message is of {lines[0].time_ns} ns since 1970: at least 0")
    file = RecordFile(out, _about(flight, clocks), files, lines[0].time_ns, ros=ros)
    try:
        for line in lines:
            file.write(line.topic, line.time_ns, line.data)
        file.finish()
    except BaseException:
        file.abandon()
        os.unlink(out)
        raise
    return file.messages


def _lines(flight: LoadedFlight, clocks: ClockPair) -> Iterator[RecordLine]:
    """Everything, by kind."""
    scribe = RecordEncoder([joint.name for joint in flight.briefing.joints], clocks)
    modes = {each.time: each.mode for each in news(flight) if isinstance(each, Tick)}
    for answer in answers(flight):
        scribe.mode = modes.get(answer["time"], scribe.mode)
        yield from scribe.take(answer)
    buses = [str(name) for name in flight.meta.get("buses") or ()]
    for entry in wire(flight):
        yield RecordLine(WIRE, clocks.wall(entry.time), _wire(entry, buses))


def _wire(entry: FlightEntry, buses: list[str]) -> bytes:
    bus = None if entry.bus == NO_BUS else entry.bus
    name = buses[bus] if bus is not None and bus < len(buses) else "" if bus is None else str(bus)
    said = {"bus": name, "kind": _NAMES[entry.kind], "hex": entry.data.hex()}
    if entry.kind == EntryKind.PORT:
        said = {"bus": name, "kind": "port", "text": entry.data.decode(errors="replace")}
    return json.dumps(said).encode()


def _about(flight: LoadedFlight, clocks: ClockPair) -> dict[str, str]:
    about = {"version": flight.briefing.version, "robot": flight.briefing.robot}
    return about | clock_words(clocks) | {f"flight_{key}": str(value) for key, value in flight.meta.items()}
