"""The ring in shared memory: one process appends, others copy it.

They copy it also when the writer was killed meanwhile. No locks: a segment is only ever extended. Its row in
the table gives its valid bytes, and its sequence number is 0 while it is used anew. No clock, no thread.
"""

import contextlib
import fcntl
import mmap
import os
import select
import struct

from twind.flight.flight_records import HEAD, MORE, ON, RECORD, FlightContents, PackedFlight, broken

TRANSCRIPT = 256 << 10  # bytes that `FlightRing.keep` accepts of one bus
SEGMENTS = 64  # segments of a ring: a copy may lack one of the oldest
SETTLE = 0.001  # s after which all cores have the stores of one, in whatever order it made them
LEAST = 4096  # bytes of a ring

_MAGIC = b"twring1\0"
_GEOMETRY = struct.Struct("=8s5I")  # magic, segments, bytes of each, buses, bytes of a transcript, first byte
# where the signature is, and its bytes
_SIGNED = 32
SIGNATURE = 16
_TABLE = 64  # where the table begins: (sequence, used bytes) of each segment, then of two transcripts a bus
_ROW = struct.Struct("=QQ")
_FUTURE_WRITE = 0x10  # F_SEAL_FUTURE_WRITE, Linux 5.1


class FlightRing:
    """The writer's end, of which there is one: appending never fails, waits or grows.

    A record that does not fit into the rest of a segment begins the next one. One larger than a segment is
    split over several, and readers join it. One over half of the ring is left out, and counted.
    """

    def __init__(self, fd: int, memory: mmap.mmap) -> None:
        self.fd = fd  # a memfd that no other process can write to or cut; closed by `close`
        self.refused = 0  # records and transcripts that were too large
        self.size = len(memory)  # bytes
        _, self._count, self._segment, self._buses, self._slot, self._first = _GEOMETRY.unpack_from(memory)
        self._memory = memory
        self._view = memoryview(memory)
        self._table = self._view[_TABLE : self._first].cast("Q")  # a store into it is one word, never half
        self._at = -1
        self._sequence = 0
        self._kept = 0
        self._base = self._used = 0
        self._turn()

    @classmethod
    def create(cls, size: int, *, buses: int = 4, transcript: int = TRANSCRIPT) -> "FlightRing":
        """Create a ring of `size` bytes with room for two transcripts of each bus.

        All pages are allocated.

        Raises OSError (no memory), ValueError (less than `LEAST`).
        """
        if size < LEAST:
            raise ValueError(f"a flight recorder of {size} bytes: at least {LEAST}")
        segment = size // SEGMENTS
        first = _TABLE + _ROW.size * (SEGMENTS + 2 * buses)
        total = first + SEGMENTS * segment + 2 * buses * transcript
        fd = os.memfd_create("flight", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        try:
            os.posix_fallocate(fd, 0, total)  # else a full memory is a SIGBUS in a tick
            memory = mmap.mmap(fd, total)
            memory[:: mmap.PAGESIZE] = bytes(-(-total // mmap.PAGESIZE))  # no page fault is left for the loop
            _GEOMETRY.pack_into(memory, 0, _MAGIC, SEGMENTS, segment, buses, transcript, first)
            fcntl.fcntl(fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW)
            with contextlib.suppress(OSError):  # an older kernel: readers could write, and do not
                fcntl.fcntl(fd, fcntl.F_ADD_SEALS, _FUTURE_WRITE | fcntl.F_SEAL_SEAL)
        except BaseException:
            os.close(fd)
            raise
        return cls(fd, memory)

    def append(self, kind: int, bus: int, time: float, data: bytes | bytearray | memoryview) -> None:
        """Append one record at `time` (s, monotonic). A memoryview must be one of bytes."""
        end = self._used + HEAD + len(data)
        if end > self._segment:
            if HEAD + len(data) > self._segment:
                self._split(kind, bus, time, memoryview(data))
                return
            self._turn()
            end = HEAD + len(data)
        at = self._base + self._used
        RECORD.pack_into(self._view, at, len(data), kind, bus, time)
        self._memory[at + HEAD : self._base + end] = data
        # last: from here on readers use the record, so its bytes must be complete
        self._used = self._table[2 * self._at + 1] = end

    def keep(self, bus: int, data: bytes) -> None:
        """Store the last whole identification of a bus, as `pack` makes it.

        Readers get it or the one before.
        """
        if bus >= self._buses or len(data) > self._slot:
            self.refused += 1
            return
        pair = 2 * bus, 2 * bus + 1
        place = min(pair, key=lambda place: self._table[2 * (self._count + place)])  # the older one
        row = 2 * (self._count + place)
        at = self._first + self._count * self._segment + place * self._slot
        self._kept += 1
        # The row is 0 while its data change, and set last: a reader in between takes the older transcript.
        self._table[row] = 0
        self._view[at : at + len(data)] = data
        self._table[row + 1] = len(data)
        self._table[row] = self._kept

    def sign(self, signature: bytes) -> None:
        """Store the identity of this robot, `SIGNATURE` bytes.

        A later reader may run for another robot and compares them.
        """
        self._memory[_SIGNED : _SIGNED + SIGNATURE] = signature

    def close(self) -> None:
        """Release the ring; a process that holds its descriptor can go on reading."""
        self._table.release()
        self._view.release()
        self._memory.close()
        os.close(self.fd)

    def _turn(self) -> None:
        """Advance to the next segment, whose old records are lost from now on."""
        self._at = (self._at + 1) % self._count
        self._base = self._first + self._at * self._segment
        self._used = 0
        self._sequence += 1
        self._table[2 * self._at] = 0
        self._table[2 * self._at + 1] = 0
        self._table[2 * self._at] = self._sequence

    def _split(self, kind: int, bus: int, time: float, data: memoryview) -> None:
        if len(data) > self._count * self._segment // 2:
            self.refused += 1
            return
        on = 0
        while data:
            room = self._segment - self._used - HEAD
            if room <= 0:
                self._turn()
                continue
            piece = data[:room]
            data = data[room:]
            self.append(kind | on | (MORE if data else 0), bus, time, piece)
            on = ON


def read(fd: int) -> FlightContents:
    """Return `copy` as entries. Raises InvalidInput."""
    return copy(fd).parse()


def copy(fd: int) -> PackedFlight:
    """Copy the content of a ring, from any process at any moment.

    This works also while its writer appends, or after it was killed in the middle of that.

    The copy is the end of all that was appended until some moment of this call, without a gap. It takes some
    ms and costs the writer nothing. It is empty where the writer goes round the whole ring meanwhile. Raises
    InvalidInput.
    """
    count, segment, buses, slot, first = _geometry(fd)
    newest = max(sequence for sequence, _ in _rows(fd, first)[:count])
    _settle()
    # By now the rows before the newest are final, and the newest is valid up to its own row's length.
    rows = _rows(fd, first)
    _settle()
    second = first + count * segment
    places = [first + place * segment for place in range(count)]
    places += [second + place * slot for place in range(2 * buses)]
    parts = [os.pread(fd, used, place) for place, (_, used) in zip(places, rows, strict=True)]
    _settle()
    again = _rows(fd, first)
    whole = [old[0] if old[0] == new[0] else 0 for old, new in zip(rows, again, strict=True)]
    found = {whole[place]: parts[place] for place in range(count) if whole[place]}
    run = []
    while newest in found:
        run.append(found[newest])
        newest -= 1
    best = [max(2 * bus, 2 * bus + 1, key=lambda place: whole[count + place]) for bus in range(buses)]
    kept = {bus: parts[count + place] for bus, place in enumerate(best) if whole[count + place]}
    return PackedFlight(kept, b"".join(reversed(run)))


def held_span(fd: int) -> tuple[float | None, int]:
    """Return the time of the oldest record (s, monotonic) and the bytes of all records.

    The time is None where it is not known at this moment. Takes some 30 us. Raises InvalidInput.
    """
    count, segment, _, _, first = _geometry(fd)
    rows = _rows(fd, first)[:count]
    _, place = min(((row[0], place) for place, row in enumerate(rows) if row[0]), default=(0, 0))
    head = os.pread(fd, HEAD, first + place * segment) if rows[place][1] else b""
    there = (
        _rows(fd, first)[place][0] == rows[place][0]
    )  # else the segment is used anew, and its head is of another time
    oldest = RECORD.unpack(head)[3] if head and there else None
    return oldest, sum(used for sequence, used in rows if sequence)


def signature(fd: int) -> bytes:
    """Return the signature that the writer stored; zeros: none. Raises InvalidInput."""
    _geometry(fd)
    return os.pread(fd, SIGNATURE, _SIGNED)


def _settle() -> None:
    select.select((), (), (), SETTLE)


def _geometry(fd: int) -> tuple[int, int, int, int, int]:
    """Segments, bytes of each, buses, bytes of a transcript, first byte. Raises InvalidInput."""
    head = b""
    with contextlib.suppress(OSError):
        head = os.pread(fd, _GEOMETRY.size, 0)
    if len(head) == _GEOMETRY.size and head.startswith(_MAGIC):
        _, count, segment, buses, slot, first = _GEOMETRY.unpack(head)
        if os.fstat(fd).st_size == first + count * segment + 2 * buses * slot:
            return count, segment, buses, slot, first
    raise broken("flight recorder", "this descriptor is none of this version")


def _rows(fd: int, first: int) -> list[tuple[int, int]]:
    """Return (sequence, used bytes) of each segment, then of each transcript."""
    return list(_ROW.iter_unpack(os.pread(fd, first - _TABLE, _TABLE)))
