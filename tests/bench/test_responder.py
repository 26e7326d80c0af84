"""The servos of the bus figures answer reads of any length, as those of a reader that misses a reply."""

from bench.responder import READING, ScriptedServos
from twind_drivers.dynamixel.packet import Framer, sync_read


def test_a_longer_read_holds_the_reading_where_its_registers_are() -> None:
    servos = ScriptedServos(2)
    request = sync_read((1, 2, 3), 120, 20)
    [(size, answer)] = servos.parse_requests(request)
    assert size == len(request)
    found = Framer(status=True).feed(answer)
    assert [(each.id, each.params[1:]) for each in found] == [
        (id, bytes(6) + READING + bytes(4)) for id in (1, 3)
    ]
