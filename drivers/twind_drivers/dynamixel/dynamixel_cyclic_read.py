"""Cyclic reading of a Dynamixel bus: one fast (or plain) read of 10 bytes from every device."""

from collections.abc import Sequence

import numpy as np

from twind_drivers.bus import Bools, Ints, SlowRegisterValues
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.device_layout import DeviceLayout
from twind_drivers.dynamixel.packet import CAPACITY, STATUS_OVERHEAD
from twind_drivers.dynamixel.replies import FastSyncReadReply, StatusReply
from twind_drivers.flags import some
from twind_drivers.half_duplex.cyclic_read import CyclicRead, CyclicRequest
from twind_drivers.half_duplex.half_duplex_transactor import SerialTransaction
from twind_drivers.half_duplex.pending_reply import Octets, PendingReply

ROW = np.dtype([("effort", "<i2"), ("velocity", "<i4"), ("position", "<i4")])
REFUSALS = (
    packet.StatusErrorCode.DATA_LENGTH,
    packet.StatusErrorCode.ACCESS,
)  # of a block that a device does not have


class DynamixelCyclicRead(CyclicRead):
    """Cyclic reading of m devices of any layouts. `fast`: every one of them supports fast reads."""

    def __init__(self, ids: tuple[int, ...], layouts: Sequence[DeviceLayout], *, fast: bool) -> None:
        self._layouts = tuple(layouts)
        self._data: Octets | None = None
        most = CAPACITY // len(ids) - STATUS_OVERHEAD  # bytes of each device that a reply has room for
        wider = [
            (before, size)
            for before, size in layouts[0].wider
            if size <= most and all((before, size) in other.wider for other in layouts)
        ]
        super().__init__(ids, ROW.itemsize, wider, fast=fast)

    def block(self, place: int) -> tuple[int, int]:
        """Return address and size of the cyclic block of one device."""
        return self._layouts[place].cyclic.address, ROW.itemsize

    def _decode(self, request: CyclicRequest) -> tuple[Ints, Ints, Ints]:
        data = request.reply.data
        if data is not self._data:
            self._data = data
            rows = data[:, request.before : request.before + ROW.itemsize].view(ROW)[:, 0]
            self._position = rows["position"]
            self._velocity = rows["velocity"]
            self._effort = rows["effort"]
        position = self._position.astype(np.int64)
        velocity = self._velocity.astype(np.int64)
        effort = self._effort.astype(np.int64)
        return position, velocity, effort

    def _refusing(self, reply: PendingReply) -> Bools:
        return reply.answered & ~reply.heard & np.isin(reply.error & 0x7F, REFUSALS)

    def _make_request(self, before: int, size: int, *, fast: bool = False) -> CyclicRequest:
        """Read `size` bytes from `before` bytes ahead of the cyclic block, of every device not parked."""
        starts = {self.ids[place]: self.block(place)[0] - before for place in self._places.tolist()}
        ids = tuple(starts)
        reply = FastSyncReadReply(ids, size) if fast else StatusReply(ids, size)
        if len(set(starts.values())) == 1:
            build = packet.fast_sync_read if fast else packet.sync_read
            request = build(ids, starts[ids[0]], size)
        else:  # layouts differ: a bulk read has an address for each
            bulk = packet.fast_bulk_read if fast else packet.bulk_read
            request = bulk({id: (start, size) for id, start in starts.items()})
        return CyclicRequest(SerialTransaction(request, reply, 1 if fast else len(ids)), reply, before, fast)


class CodedAlertRead(DynamixelCyclicRead):
    """Cyclic reading of a bus with Y servos, none of which has fast reads.

    A Y raises its alert for a tripped watchdog too. So the alert of the `coded` devices (m,) counts once
    `registers` hold a hardware error, which are read 20 times a second.
    """

    def __init__(
        self,
        ids: tuple[int, ...],
        layouts: Sequence[DeviceLayout],
        coded: Bools,
        registers: SlowRegisterValues,
    ) -> None:
        self._coded = coded
        self._registers = registers
        super().__init__(ids, layouts, fast=False)

    def _errors(self, reply: PendingReply) -> Octets:
        error = reply.error
        if not some(error):
            return error
        calm = (self._coded & (self._registers.fault <= 0))[self._places]
        return np.where(calm, error & ~np.uint8(packet.ALERT), error)
