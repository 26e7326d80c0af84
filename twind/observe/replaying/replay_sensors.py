"""What hangs on a recorded bus besides its servos and only tells: its registers as they were read. Pure."""

from bisect import bisect_right

from twind.observe.replaying.device_timeline import BusTimeline
from twind.observe.replaying.recorded_exchanges import DeviceReply
from twind_drivers.dynamixel.packet import Instruction, status

AGO = 0.1  # s, since it was read last: for so long it tells the same, then it is silent as it was


class ReplaySensors:
    """Devices that never said a model number, and told blocks of registers. Times of the recording, s."""

    def __init__(self, story: BusTimeline) -> None:
        self._times: dict[int, list[float]] = {}
        self._told: dict[int, list[DeviceReply]] = {}
        for exchange in story.told:
            for each in exchange.told:
                if each.id not in story.models and each.data:
                    self._times.setdefault(each.id, []).append(exchange.time)
                    self._told.setdefault(each.id, []).append(each)

    def answer(self, question: bytes, moment: float) -> bytes:
        """The status of one of them to a read at that moment; empty: it is of nobody here, or silent then.

        Before the recording begins all is as it was first read.
        """
        id = question[4]
        if id not in self._told or question[7] != Instruction.READ:
            return b""
        address, size = (int.from_bytes(question[at : at + 2], "little") for at in (8, 10))
        times = self._times[id]
        place = max(0, bisect_right(times, moment) - 1)
        each = self._told[id][place]
        data = each.data[address - each.address :][:size] if address >= each.address else b""
        if moment - times[place] > AGO or len(data) != size:
            return b""
        return status(id, each.error, data)
