"""Faults on order of a virtual CAN bus, each by what a host sees of it."""

import json
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.can_loopback import CanLoopback
from tests.support.driver_rig import is_output_full
from tests.support.virtual_can_host import LIMP, CanHost, mit
from twind.exceptions import InvalidInput
from twind.virtual.fault_commands import arguments
from twind_drivers.bus import PortError
from twind_drivers.can.can_twin import CAN_FAULTS
from twind_drivers.ports.channel import CanErrorState
from twind_drivers.ports.frame import ERROR
from twind_drivers.virtual.can.can_controller import CanAdapter
from twind_drivers.virtual.can.can_message import CanMessage, as_frames
from twind_drivers.virtual.can.node_spec import NodeSpec

NODES = [NodeSpec(id, "DM4310", 0x10 + id) for id in (1, 2)]


def two() -> CanHost:
    return CanHost(NODES)


def answers(host: CanHost, wait: float = 0.005) -> list[int]:
    return [each.id for each in host.ask((1, LIMP), (2, LIMP), wait=wait)]


def test_dropped_doubled_and_foreign_frames() -> None:
    host = two()
    host.faults.drop(1, 1)
    host.faults.duplicate(1, 2)
    assert answers(host) == [0x12, 0x12]
    assert answers(host) == [0x11, 0x12]
    host.faults.foreign(1)
    heard = answers(host)
    assert sorted(heard) == [0x11, 0x12, 0x6F3]


def test_a_late_reply_arrives_in_the_next_cycle_with_the_earlier_reading() -> None:
    host = two()
    host.faults.delay(0.012, 1)
    assert answers(host, wait=0.01) == [0x12]
    assert answers(host, wait=0.01) == [0x12, 0x11]
    host.faults.clear()
    assert sorted(answers(host, wait=0.02)) == [0x11, 0x11, 0x12], "behind its late one"


def test_a_duplicate_node_answers_from_another_position() -> None:
    host = two()
    host.faults.twin(1)
    one, other = host.ask((1, LIMP))
    assert one.id == other.id
    assert one.data != other.data


def test_a_silenced_node_receives_nothing_and_keeps_its_torque() -> None:
    host = two()
    host.ask((1, mit(0xFC)))
    host.faults.silence(1)
    assert answers(host) == [0x12]
    host.ask((1, mit(0xFD)))
    assert host.truth()["torque"]
    host.faults.clear()
    assert answers(host) == [0x11, 0x12]


def test_a_wrong_range_shows_another_position() -> None:
    host = CanHost([NodeSpec(1, "AK70-10", position=12.5)], start=1.0)
    before = host.ask((1, LIMP))[0].data[1:3]
    host.faults.ranges(1, 25.0, 50.0, 25.0)
    assert host.ask((1, LIMP))[0].data[1:3] != before
    damiao = CanHost([NODES[0]])
    damiao.faults.ranges(1, 6.0, 10.0, 5.0)
    [told] = damiao.ask((0x7FF, bytes([1, 0, 0x33, 21, 0, 0, 0, 0])))
    assert struct.unpack("<f", told.data[4:]) == (6.0,), "a Damiao says so"


def test_a_lost_zero_and_a_turn_that_comes_with_the_enabling() -> None:
    host = two()
    host.faults.zero_lost(1, 0.5)
    assert host.truth()["position"] == pytest.approx(0.5 * 16384 / 6.283185307)
    host.faults.wrap(2)
    assert host.truth(1)["position"] == 0.0
    host.ask((2, mit(0xFC)))
    assert host.truth(1)["position"] == pytest.approx(16384)
    host.ask((2, mit(0xFD)), (2, mit(0xFC)))
    assert host.truth(1)["position"] == pytest.approx(16384), "once"


def test_heat_and_supply_are_reported_and_end_torque() -> None:
    host = two()
    host.ask((1, mit(0xFC)), (2, mit(0xFC)))
    host.faults.heat(1, 80.0)
    assert host.ask((1, LIMP))[0].data[6:] == bytes([80, 80])
    host.faults.heat(1, 120.0)
    assert host.ask((1, LIMP))[0].data[0] >> 4 == 0xC
    host.faults.supply(5.0)
    assert host.ask((2, LIMP))[0].data[0] >> 4 == 9
    host.ask((2, mit(0xFB)))
    assert host.ask((2, LIMP))[0].data[0] >> 4 == 9, "still too low"
    host.faults.supply(24.0)
    host.ask((2, mit(0xFB)))
    assert host.ask((2, LIMP))[0].data[0] >> 4 == 0


def test_commands_of_another_master_are_executed_and_visible() -> None:
    host = two()
    host.faults.master(1)
    heard = host.wait(0.105)
    assert sum(each == CanMessage(1, LIMP) for each in heard) == 10
    assert sum(each.id == 0x11 for each in heard) == 10
    host.faults.clear()
    host.wait(0.02)
    assert host.wait(0.1) == []


def test_a_shaft_that_is_held_and_an_encoder_that_stands_still() -> None:
    host = two()
    push = bytes.fromhex("8A3C7FF1993337FF")
    host.ask((1, mit(0xFC)), (2, mit(0xFC)))
    host.faults.lock(1)
    host.faults.freeze(2)
    host.ask((1, push), (2, push), wait=0.5)
    assert host.truth()["position"] == 0.0
    assert host.truth(1)["position"] == 0.0
    assert host.truth(1)["encoder"] > 2000
    host.faults.free(1)
    host.faults.freeze(2, False)
    host.wait(0.5)
    assert min(host.truth(row)["position"] for row in (0, 1)) > 2000


def test_an_adapter_that_echoes_gives_back_what_has_left() -> None:
    host = two()
    host.faults.echo()
    assert [each.id for each in host.ask((1, LIMP))] == [1, 0x11]


def test_an_error_frame_is_reported_and_takes_wire_time() -> None:
    host = two()
    host.faults.error_frames(3)
    host.wait(0.0)
    assert len(host.errors) == 3
    assert all(each.id & ERROR for each in host.errors)


def test_recorded_positions_equal_those_the_nodes_reported() -> None:
    host = two()
    host.faults.record(100)
    host.ask((1, mit(0xFC)), (1, bytes.fromhex("8A3C7FF1993337FF")), wait=0.1)
    host.ask((1, LIMP))
    times, places = host.bus.history.readings()
    assert (np.diff(times) > 0).all()
    assert places.shape == (len(times), 2)
    assert places[-1, 0] > 1000
    host.faults.record(0)
    assert host.bus.history is None


def test_faults_in_the_vendors_codes_have_their_bounds() -> None:
    host = CanHost([*NODES, NodeSpec(0x7F, "RS01")])
    for id, bits in ((1, 7), (1, 16), (0x7F, 64)):
        with pytest.raises(ValueError, match="damage"):
            host.faults.damage(id, bits)
    with pytest.raises(KeyError, match=r"no node with id 9; ids are \[1, 2, 127\]"):
        host.faults.damage(9, 8)


# ------------------------------------------------------------------------------- the channel in process


def channel(**made: bool) -> tuple[CanHost, CanLoopback]:
    host = CanHost(NODES, adapter=CanAdapter(**made), opened=False)
    return host, CanLoopback(host.bus, host.clock)


def send(host: CanHost, link: CanLoopback, data: bytes = LIMP) -> None:
    link.send(as_frames([CanMessage(1, data)]), host.clock.now())


def test_the_channel_carries_frames_and_wakes_its_reader() -> None:
    host, link = channel()
    send(host, link)
    heard = 0
    while np.isfinite(link.arrival()):
        host.clock.wait([link], 1.0)
        heard += len(link.receive(host.clock.now()))
    assert heard == 1


def test_the_channel_refuses_while_old_frames_wait_and_is_lost_after_a_second() -> None:
    host, link = channel()
    host.faults.unacknowledged()
    send(host, link)
    for _ in range(10):
        host.clock.sleep_until(host.clock.now() + 0.1)
        with pytest.raises(PortError, match="1 bytes still wait", check=is_output_full):
            send(host, link)
        host.bus.take_host_frames(as_frames([CanMessage(1, LIMP)]), host.clock.now())
    host.clock.sleep_until(host.clock.now() + 0.11)
    with pytest.raises(PortError, match="has accepted nothing for 1") as lost:
        send(host, link)
    assert lost.value.lost
    assert link.condition.line == CanErrorState.OFF
    host.faults.unacknowledged(False)
    assert host.wait(0.1) == [], "what waited was purged"


def test_a_kernel_s_queue_survives_purge_and_close_and_is_replayed() -> None:
    """Facts 8: frames already queued go out when power returns: the arm snaps to its old goals."""
    host, link = channel(keeps=True)
    host.faults.power(False)
    send(host, link, mit(0xFC))
    link.purge()
    link.close()
    host.faults.power(True)
    host.wait(1.0)
    assert host.truth()["torque"]


def test_bus_off_and_passive_states_are_reported_and_end() -> None:
    host, link = channel()
    for order, line in (
        (host.faults.passive, CanErrorState.PASSIVE),
        (host.faults.bus_off, CanErrorState.OFF),
    ):
        order(True)
        assert not link.receive(host.clock.now()).size
        assert link.condition.line == line
        order(False)
        link.receive(host.clock.now())
        assert link.condition.line == CanErrorState.ACTIVE


def test_frames_of_the_host_wait_while_the_bus_is_off() -> None:
    host = two()
    host.faults.bus_off()
    host.ask((1, mit(0xFC)))
    assert not host.truth()["torque"]
    host.faults.bus_off(False)
    host.wait(0.01)
    assert host.truth()["torque"], "what waited goes out"


def test_an_unplugged_channel_is_lost() -> None:
    host, link = channel()
    host.faults.unplug()
    for use in (lambda: link.receive(0.0), lambda: send(host, link), link.purge):
        with pytest.raises(PortError, match="unplugged"):
            use()
    link.close()
    link.close()


# ------------------------------------------------------------------------------- orders


def test_orders_of_the_other_kind_of_bus_are_refused() -> None:
    with pytest.raises(InvalidInput, match="no fault 'babble'; there are drop"):
        arguments({"fault": "babble"}, CAN_FAULTS)
    assert arguments({"fault": "wrap", "id": 3}, CAN_FAULTS) == ("wrap", {"id": 3})


def orders_shown(page: str) -> list[dict[str, Any]]:
    return [json.loads(each) for each in re.findall(r'`(\{"fault".*?\})`', page)]


def test_the_page_shows_every_order_and_what_it_shows_is_right() -> None:
    docs = Path(__file__).parents[2] / "docs"
    page = (docs / "virtual-can.md").read_text()
    shown = orders_shown(page)
    shared = re.findall(
        r"`(\w+)`", page.partition("The same as there: ")[2].partition("Different on CAN:")[0]
    )
    assert not {order["fault"] for order in shown} & {*shared}
    shown += [order for order in orders_shown((docs / "virtual.md").read_text()) if order["fault"] in shared]
    assert {arguments(each, CAN_FAULTS)[0] for each in shown} == set(CAN_FAULTS)
    host = CanHost([NodeSpec(7, "DM4310", 0x17)])
    for order in shown:
        name, given = arguments(order, CAN_FAULTS)
        if name == "lay":  # there is no body here
            with pytest.raises(ValueError, match="no body"):
                host.faults.lay(**given)
            continue
        if "pose" in given:  # there are no joints here
            with pytest.raises(KeyError, match="no joint 'l_knee'"):
                host.faults.hand(**given)
            continue
        getattr(host.faults, name)(**given)
