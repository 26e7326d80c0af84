"""Any faults in any order: the bus never fails, never stands still, and is as before once they are healed."""

from math import inf

from hypothesis import example, given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.virtual_serial_host import Host
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.packet import Framer

IDS = [1, 2, 3, 4]
REQUESTS = [
    packet.ping(2),
    packet.ping(254),
    packet.sync_read(IDS, 126, 10),
    packet.fast_sync_read(IDS, 126, 10),
    packet.write(3, 65, b"\1"),
    packet.sync_write(116, {id: (2048).to_bytes(4, "little") for id in IDS}) + packet.sync_read(IDS, 132, 4),
    b"\xff\xff\xfd\x00\xfe\xff\x07\x82",
]
counts = {"count": st.integers(0, 5)}
one = {"id": st.sampled_from([None, *IDS])}
switch = {"on": st.booleans()}
seconds = {"seconds": st.sampled_from([0.0, 1e-5, 3e-4, 0.004, 0.05])}
ORDERS = {
    "drop": counts | one,
    "corrupt": counts | one | {"bits": st.integers(1, 64)},
    "foreign": counts | one,
    "duplicate": counts | one,
    "cut": counts | one | {"bytes": st.integers(0, 20)},
    "noise": seconds | counts | one,
    "delay": seconds | one,
    "bit_errors": {"rate": st.sampled_from([0.0, 1e-4, 0.01, 0.5]), "to_host": st.booleans()},
    "babble": switch,
    "split": {"bytes": st.integers(0, 9)},
    "latency": {"seconds": st.sampled_from([0.0, 0.001, 0.016]), "payload": st.sampled_from([1, 62, 510])},
    "echo": switch,
    "collide": switch,
    "garble": switch,
    "stall": switch,
    "silence": switch | one,
    "record": {"count": st.integers(0, 3)},
}
orders = st.sampled_from(sorted(ORDERS)).flatmap(
    lambda name: st.tuples(st.just(name), st.fixed_dictionaries(ORDERS[name]))
)
steps = st.one_of(
    orders,
    st.sampled_from([(request, pause) for request in REQUESTS for pause in (0.0, 1e-4, 0.01)]),
)


def listen(host: Host, until: float) -> bytes:
    """Return the bytes that the host receives, in no more polls than time and bytes allow."""
    out = b""
    looks = 0
    while host.bus.next_output_time() <= until:
        host.clock.sleep_until(host.bus.next_output_time())
        out += host.bus.take(host.clock.now())
        looks += 1
        assert looks < 3000, "the bus is due for ever and time stands still"  # split: 2000 pieces in 10 ms
    host.clock.sleep_until(until)
    return out


@examples(60)
@example([("noise", {"seconds": 0.05, "count": 1}), ("split", {"bytes": 1}), (REQUESTS[4], 0.01)], False)
@given(st.lists(steps, max_size=12), st.booleans())
def test_the_bus_recovers_completely_after_any_sequence_of_faults(run: list[tuple], timing: bool) -> None:
    host = Host(IDS, wire_timing=timing)
    clean = [host.raw(request) for request in REQUESTS[:3]]
    for what, more in run:
        if isinstance(what, str):
            getattr(host.bus.faults, what)(**more)
        else:
            host.bus.receive(what, host.clock.now())
            listen(host, host.clock.now() + more)
    host.bus.faults.clear()
    listen(host, host.clock.now() + 1.0)
    assert host.bus.next_output_time() == inf
    host.bus.receive(bytes(3000), host.clock.now())  # a broken LEN may promise so much
    listen(host, host.clock.now() + 1.0)
    assert [host.raw(request) for request in REQUESTS[:2]] == clean[:2]
    assert [each.id for each in Framer(status=True).feed(host.raw(REQUESTS[2]))] == IDS
