"""Channel over any adapter that python-can drives: no thread, no Notifier, time is an argument.

Importing this costs a tenth of a second, so `can_ports.py` does it only for a robot that has such an adapter.

Over socketcan a full queue shows only as ENOBUFS, and frames accepted before stay in the kernel: of a
batch that was refused, the first frames may have left. After a loss no probe is sent: identification, which
comes first, only reads, so its frames are the probe.
"""

import errno
import logging
import os
import struct
import weakref
from collections.abc import Callable
from contextlib import suppress
from math import inf

import can
import numpy as np

from twind_drivers.bus import PortError, PortErrorCause
from twind_drivers.ports.can_interface_control import interfaces, long_queue, restart
from twind_drivers.ports.can_interface_lock import CanInterfaceLock
from twind_drivers.ports.channel import CanChannelStatus, CanErrorState
from twind_drivers.ports.frame import (
    ERROR,
    EXTENDED,
    EXTENDED_MASK,
    FRAME,
    NOTHING,
    REMOTE,
    STANDARD_MASK,
    Frames,
)
from twind_drivers.ports.transmit_stall import DEAD, DEAF, ChannelStatusTracker, dead, queue_full

RECORD = struct.Struct("<IB3x8s")  # one of FRAME
MOST = 4096  # frames of one `receive`: a babbling line never runs dry
FULL = frozenset({errno.ENOBUFS, errno.EAGAIN})
FULL_WORDS = ("transmit buffer full", "could not send message to one or more recipients")  # without a number
GONE = frozenset({errno.ENODEV, errno.ENXIO, errno.ENETDOWN, errno.ENETUNREACH, errno.EBADF})
# Of an error frame (linux/can/error.h): in its id, in data[1] of CRTL, in data[2] of PROT.
CRTL = 0x4
PROT = 0x8
BUSOFF = 0x40
RESTARTED = 0x100
WARNINGS = 0x0C
PASSIVES = 0x30
ACTIVE = 0x40
PROT_ACTIVE = 0x40
# A back end raises CanError, or whatever its vendor's library does (struct.error, RuntimeError,
# AttributeError after an unplug): each means that this bus no longer works, none may end the daemon.
FAILURES = Exception


class PythonCanChannel:
    """One `can.Bus`. `bitrate` in bit/s; a socketcan interface has its own, set by `ip link`.

    A socketcan interface has one owner (`can_interface_lock.py`). Whether another adapter can be opened twice
    is the matter of its library.
    """

    def __init__(self, interface: str, channel: str, bitrate: int, *, search: bool = True) -> None:
        """Opens the bus. Raises PortError that says what is wrong and what to do.

        `search`: see `CanInterfaceLock`.
        """
        self.interface = interface
        self.channel = channel
        self.bitrate = bitrate
        self.name = channel
        self.condition = CanChannelStatus()
        self._standing = ChannelStatusTracker(self.condition)
        self._early: can.Message | None = None  # taken to learn whether there is one
        self._received_at = self._now = self._restarted = -inf  # s; of the last call, and of the link
        self._doubtful = False  # sent frames may still wait: none was received shortly before the last send
        self._owner: Callable[[], object | None] = lambda: None  # owner that drives motors, while it lives
        self._own_warning = ""  # this channel's part of `warning`
        quiet = logging.getLogger("can")  # its messages are already in the errors raised here
        if not quiet.handlers:
            quiet.addHandler(logging.NullHandler())
        self._sign = CanInterfaceLock(channel, search=search) if interface == "socketcan" else None
        try:
            self._bus: can.BusABC | None = self._open_bus()
        except PortError:
            self._disown()
            raise
        self.warning = ""
        if interface == "socketcan":
            self._warn(long_queue(channel))

    def fileno(self) -> int:
        """Descriptor to poll; -1 where the bus has none, or once closed."""
        try:
            return -1 if self._bus is None else self._bus.fileno()
        except FAILURES:
            return -1

    def arrival(self) -> float:
        """Return -inf: data, or an error for the next read, is available; inf: nothing yet, as far as known.

        A bus without descriptor reports no arrivals, so its user queries repeatedly.
        """
        if self._bus is None:
            return -inf
        if self._early is None:
            try:
                self._early = self._bus.recv(timeout=0)
            except FAILURES:
                return -inf
        return inf if self._early is None else -inf

    def send(self, frames: Frames, now: float) -> None:
        """All, in this order. Raises PortError, ValueError for what is no frame."""
        messages = [_message(frame) for frame in frames.tolist()]
        bus = self._require()
        self._now = now
        self._doubtful |= bool(messages) and now - self._received_at >= DEAF
        for taken, message in enumerate(messages):
            try:
                bus.send(message, timeout=0)
            except FAILURES as error:
                if not _is_queue_full(error):
                    raise self._make_lost_error("send", error) from error
                self._refuse(taken, len(messages), now)
        if messages:
            self._standing.stall.record_acceptance()
            self._standing.settle()

    def receive(self, now: float) -> Frames:
        """All that has arrived; error frames become the condition. Raises PortError of kind LOST."""
        bus = self._require()
        self._now = now
        records: list[bytes] = []
        message = self._early
        self._early = None
        try:
            for _ in range(MOST):
                if message is None and (message := bus.recv(timeout=0)) is None:
                    break
                self._take(message, records)
                message = None
        except FAILURES as error:
            raise self._make_lost_error("receive", error) from error
        if records:
            self._received_at = now
            self._doubtful = False
            self._standing.stall.record_reception(now)
        self._standing.settle()
        return np.frombuffer(b"".join(records), FRAME) if records else NOTHING

    def drive(self, owner: object) -> None:
        """See `CanChannel.drive`."""
        self._owner = weakref.ref(owner)

    def purge(self) -> None:
        """Close the bus and open it again; a kernel interface where frames may wait goes down and up.

        That while somebody drives, at most once a second: it takes long. Where it is not permitted,
        `warning` says so. Raises PortError of kind LOST.
        """
        self._shut(empties=self._now - self._restarted >= DEAD)
        self._standing.stall.emptied()
        try:
            self._bus = self._open_bus()
        except PortError as error:
            raise PortError(self.name, error.reason, kind=PortErrorCause.LOST) from error

    def close(self) -> None:
        """Purge and release the port. May be called twice; never raises."""
        if self._bus is not None:
            self._shut(empties=True)
        self._disown()

    # ------------------------------------------------------------------------------- inside

    def _open_bus(self) -> can.BusABC:
        try:
            return can.Bus(self.channel, interface=self.interface, bitrate=self.bitrate, ignore_config=True)
        except NotImplementedError as error:
            known = ", ".join(sorted(can.VALID_INTERFACES))
            reason = f"python-can cannot drive {self.interface!r}: {error}; it supports {known}"
            raise PortError(self.name, reason) from error
        except FAILURES as error:
            raise PortError(self.name, _explain_open_failure(self.interface, self.channel, error)) from error

    def _disown(self) -> None:
        if self._sign is not None:
            self._sign.close()

    def _shut(self, *, empties: bool) -> None:
        bus = self._bus
        self._bus = None
        self._early = None
        if bus is not None:
            with suppress(FAILURES):  # an unplugged adapter raises here too
                bus.shutdown()
        waits = self.interface == "socketcan" and (self._doubtful or self._standing.stall.is_blocked)
        if waits and empties and self._owner() is not None:
            failure = restart(self.channel)
            self._warn(failure or long_queue(self.channel))
            self._restarted = self._now
            self._doubtful = False
            if not failure:  # the kernel reports a restart by itself alone, not one by its link
                self._standing.record_status(CanErrorState.ACTIVE)

    def _warn(self, text: str) -> None:
        """Set this channel's part of the warning; parts from other sources stay."""
        others = self.warning.removeprefix(self._own_warning).removeprefix("; ")
        self._own_warning = text
        self.warning = "; ".join(part for part in (text, others) if part)

    def _require(self) -> can.BusABC:
        if self._bus is None:
            raise PortError(self.name, "the channel is closed", kind=PortErrorCause.LOST)
        return self._bus

    def _refuse(self, taken: int, count: int, now: float) -> None:
        """Raise the error for a full queue: OUTPUT_FULL, after a second LOST with the queue emptied."""
        self.condition.refused += count - taken
        stall = self._standing.stall
        if taken:
            stall.record_acceptance()
        waited = stall.record_refusal(now)
        self._standing.settle()
        if waited < DEAD:
            raise queue_full(self.name, taken, count)
        with suppress(PortError):
            self.purge()
        raise dead(self.name, waited)

    def _take(self, message: can.Message, records: list[bytes]) -> None:
        """A frame goes to `records`; what is none is counted."""
        if message.is_error_frame:
            self.condition.errors += 1
            line = _line(message.arbitration_id, bytes(message.data))
            if line is not None:
                self._standing.record_status(line)
            return
        remote = message.is_remote_frame
        size = message.dlc
        data = b"" if remote else bytes(message.data)
        limit = EXTENDED_MASK if message.is_extended_id else STANDARD_MASK
        whole = size <= 8 and (remote or len(data) == size) and 0 <= message.arbitration_id <= limit
        if message.is_fd or not whole:
            self.condition.errors += 1
            return
        flags = (EXTENDED if message.is_extended_id else 0) | (REMOTE if remote else 0)
        records.append(RECORD.pack(message.arbitration_id | flags, size, data))

    def _make_lost_error(self, what: str, error: Exception) -> PortError:
        number = _number(error)
        hint = " (interface down, or adapter unplugged?)" if number in GONE else ""
        return PortError(self.name, f"{what} failed: {error}{hint}", kind=PortErrorCause.LOST)


def _message(row: tuple[int, int, bytes, list[int]]) -> can.Message:
    """One of FRAME, as `tolist` gives it. Raises ValueError for what is no frame."""
    flagged, size, _, data = row
    extended = bool(flagged & EXTENDED)
    remote = bool(flagged & REMOTE)
    id = flagged & EXTENDED_MASK
    if flagged & ERROR or size > 8 or id > (EXTENDED_MASK if extended else STANDARD_MASK):
        raise ValueError(
            f"id {flagged:08X} with {size} bytes cannot be sent: at most 8 bytes, an id of 11 bits or of 29 "
            "with its flag, and no error frame"
        )
    return can.Message(
        arbitration_id=id,
        is_extended_id=extended,
        is_remote_frame=remote,
        dlc=size,
        data=None if remote else data[:size],
    )


def _line(id: int, data: bytes) -> CanErrorState | None:
    """Return the controller state that an error frame reports; None: none."""
    data = data.ljust(8, b"\0")
    if id & BUSOFF:
        return CanErrorState.OFF
    if id & CRTL and data[1] & PASSIVES:
        return CanErrorState.PASSIVE
    if (
        id & RESTARTED
        or (id & CRTL and data[1] & (WARNINGS | ACTIVE))
        or (id & PROT and data[2] & PROT_ACTIVE)
    ):
        return CanErrorState.ACTIVE
    return None


def _number(error: BaseException) -> int | None:
    if isinstance(error, can.CanError):
        return error.error_code
    return error.errno if isinstance(error, OSError) else None


def _is_queue_full(error: Exception) -> bool:
    number = _number(error)
    return number in FULL or (number is None and any(words in str(error).lower() for words in FULL_WORDS))


def _explain_open_failure(interface: str, channel: str, error: Exception) -> str:
    """Describe the reason why a bus does not open, and the remedy."""
    number = _number(error)
    if number in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT):
        return (
            "this kernel has no CAN; `sudo modprobe can_raw`, or reach the adapter as "
            "can:slcan:/dev/tty..., if it is a serial one"
        )
    if interface == "socketcan" and number in GONE:
        there = f"; there are: {', '.join(interfaces())}" if interfaces() else "; there is no CAN interface"
        return (
            f"no such CAN interface{there}; plug the adapter in, then "
            f"`sudo ip link set {channel} up type can bitrate 1000000`"
        )
    if number is not None:
        return f"cannot be opened as {interface}: {os.strerror(number)}"
    return f"cannot be opened as {interface}: {error}"
