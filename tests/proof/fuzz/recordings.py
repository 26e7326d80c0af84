"""Recordings and flight files that no daemon wrote: read, exported and scored, or refused by name."""

import shutil
import struct
import tempfile
import time
import zlib
from math import inf
from pathlib import Path
from random import Random
from typing import Any

import msgspec

from tests.proof.fuzz.fuzz_target import FuzzTarget
from tests.proof.fuzz.mangle import mangled
from tests.support.golden_captures import HERE
from tests.support.sample_recordings import write
from twind.command_line.verb import Rejected
from twind.exceptions import InvalidInput, OperationFailed
from twind.flight import EntryKind, FlightContents, FlightEntry, load, pack
from twind.flight import flight_file as layout
from twind.observe.export import export
from twind.observe.recording import open_recording
from twind.observe.recover import recover
from twind.observe.replay import script_of
from twind.observe.replaying.replay_files import lay_out

LONGEST = 5.0  # s of CPU for one file
KEPT = 80  # entries of a capture
ODD: tuple[Any, ...] = (
    *(None, True, 0, 1, -1, 255, 2**31, 2**63, -(2**63), 10**18, -1e18, 1e300),
    *(
        float("nan"),
        float("inf"),
        -0.0,
        "",
        "x",
        "h24",
        "\u0000",
        "\ud7ff",
        "x" * 5000,
        "/",
        "..",
        "a/../../b",
    ),
    *(b"", b"\xff", b"\x00" * 9, b"\x00" * 8 * 24, [], {}, [[]], [None], {"a": {}}, {"kind": 1}, [1e308] * 3),
)


class Recordings(FuzzTarget):
    """Writes and reads mutated recordings in a folder of its own."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="twind-fuzz-"))
        flight = load(HERE / "limit.flight")
        self._meta = flight.meta
        self._briefing = msgspec.msgpack.decode(msgspec.msgpack.encode(flight.briefing))
        entries = flight.contents.entries
        news = [each for each in entries if each.kind not in (EntryKind.OUT, EntryKind.IN)]
        self._contents = FlightContents(flight.contents.kept, (*entries[:KEPT], *news[-KEPT:]))
        self._mcap = write(self.folder / "whole.mcap", 0.2).read_bytes()
        self.accepted = 0

    def finish(self) -> str:
        """Number of accepted inputs."""
        return f"{self.accepted} accepted"

    def close(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.folder)

    def one(self, rng: Random) -> None:
        """One input. Raises whatever is wrong."""
        if rng.random() < 0.3:
            path = self.folder / "a.mcap"
            path.write_bytes(mangled(rng, self._mcap, rng.randrange(1, 8)))
        else:
            path = self.folder / "a.flight"
            path.write_bytes(self._flight(rng))
        begun = time.process_time()
        for use in (open_recording, self._copied, self._played):
            try:
                use(path)
                self.accepted += 1
            except (Rejected, OperationFailed) as error:
                self._require_one_line(str(error))
        took = time.process_time() - begun
        assert took < LONGEST, f"{took:.1f} s for {path.stat().st_size} bytes"

    def _require_one_line(self, text: str) -> None:
        assert text and "\n" not in text, f"refused in no line: {text!r}"

    def _copied(self, path: Path) -> None:
        out = self.folder / "out.mcap"
        out.unlink(missing_ok=True)
        try:
            export(path, out)
        except Rejected:
            assert not out.exists(), "refused, and half a file is left"
            raise
        again = self.folder / "again.mcap"
        again.unlink(missing_ok=True)
        recover(out, again)

    def _played(self, path: Path) -> None:
        if path.suffix != ".flight":
            return
        try:
            flight = load(path)
        except InvalidInput as error:
            raise Rejected(str(error)) from None
        script_of(path, flight, inf)
        place = Path(tempfile.mkdtemp(dir=self.folder))
        try:
            lay_out(flight.briefing, place)
        finally:
            shutil.rmtree(place)

    # ------------------------------------------------------------------------------------------ files

    def _flight(self, rng: Random) -> bytes:
        """A flight file with right checksums whose content is not as a daemon writes it."""
        kind = rng.randrange(6)
        meta: Any = _changed(rng, self._meta) if kind == 0 else self._meta
        briefing: Any = _changed(rng, self._briefing) if kind == 1 else self._briefing
        entries = self._contents.entries
        if kind >= 2:
            entries = tuple(_entry(rng, each) if rng.random() < 0.02 else each for each in entries)
        packed = pack(entries)
        if kind == 5:
            packed = mangled(rng, packed, rng.randrange(1, 4))
        sections = [("briefing", msgspec.msgpack.encode(briefing)), ("entries", packed)]
        sections += [(f"kept {bus}", pack(each)) for bus, each in self._contents.kept.items()]
        data = [(name, zlib.compress(part, 1), len(part)) for name, part in sections]
        table: Any = [(name, len(part), size) for name, part, size in data]
        head = {"meta": meta, "sections": _changed(rng, table) if rng.random() < 0.05 else table}
        encoded = msgspec.msgpack.encode(head)
        if rng.random() < 0.05:
            encoded = mangled(rng, encoded, 1)
        start = struct.pack("<II", len(encoded), zlib.crc32(encoded))
        return b"".join((layout.MAGIC, start, encoded, *(part for _, part, _ in data)))


def _entry(rng: Random, entry: FlightEntry) -> FlightEntry:
    """An entry with another time or bus, or a message with other values."""
    kind = rng.randrange(5)
    if kind == 0:
        times = (-1.0, 0.0, 1e9, 1e18, float("nan"), float("inf"))
        return entry._replace(time=rng.choice(times))
    if kind == 1:
        return entry._replace(bus=rng.randrange(256), kind=rng.choice(list(EntryKind)))
    if kind == 2 or entry.kind not in (EntryKind.NEWS, EntryKind.COMMAND):
        return entry._replace(data=mangled(rng, entry.data, 1))
    return entry._replace(data=msgspec.msgpack.encode(_changed(rng, msgspec.msgpack.decode(entry.data))))


def _changed(rng: Random, value: Any, depth: int = 0) -> Any:
    """A copy of plain values of which one is another, lost, or there twice."""
    children = (
        list(value.items() if isinstance(value, dict) else enumerate(value))
        if value and isinstance(value, dict | list | tuple)
        else []
    )
    if not children or (depth and rng.random() < 0.15):
        return rng.choice(ODD)
    place, child = rng.choice(children)
    made = dict(value) if isinstance(value, dict) else list(value)
    kind = rng.randrange(12)
    if kind == 0:
        del made[place]
    elif kind == 1 and isinstance(made, list):
        made.insert(int(place), child)
    else:
        made[place] = _changed(rng, child, depth + 1)
    return made
