"""Services of ROS over Zenoh: what is answered, and what no other request and no odd byte may hold up."""

import threading
from collections.abc import Iterator

import pytest

from tests.support.processes import PATIENCE, until
from tests.support.ros_zenoh_node import Us, joined
from tests.support.ros_zenoh_peer import Peer
from tests.support.zenoh_router import Router
from twind.bridge.ros.ros_endpoints import (
    GET_STATUS,
    SET_LIVE,
    TO_E_STOP,
    TO_STOP,
    TRAJECTORY,
    RosService,
)
from twind.bridge.ros.zenoh.zenoh_attachment import ZenohAttachment, attachment
from twind.ros import JOINT_TRAJECTORY, SET_BOOL, TRIGGER, decode, encode

pytest.importorskip("zenoh_ros2_sdk", reason="no zenoh-ros2-sdk here (it needs git)")


@pytest.fixture(scope="module")
def router() -> Iterator[Router]:
    with Router(gossip=True) as router:
        yield router


@pytest.fixture(scope="module")
def peer(router: Router) -> Iterator[Peer]:
    with Peer(router.endpoint) as peer:
        yield peer


@pytest.fixture(scope="module")
def us(router: Router, peer: Peer) -> Iterator[Us]:
    with joined(router.endpoint) as us:
        until(lambda: peer.ask("endpoints", kind="SS"), PATIENCE, "the peer sees our services")
        yield us


def test_services_reply_with_the_result_of_the_request(us: Us, peer: Peer) -> None:
    for data in (True, False):
        answer = peer.ask("call", service=SET_LIVE.name, kind=SET_BOOL, request={"data": data})
        assert (answer["success"], answer["message"]) == (data, f"/bridge/set_mode: {data}")
    empty = {"structure_needs_at_least_one_member": 0}
    answer = peer.ask("call", service=GET_STATUS.name, kind=TRIGGER, request=empty)
    assert (answer["success"], answer["message"]) == (True, "/bridge/get_status: None")


def test_a_reply_carries_the_attachment_of_its_request(us: Us, peer: Peer) -> None:
    asked = ZenohAttachment(77, 5, bytes(range(16)))
    request = encode(f"{SET_BOOL}_Request", {"data": True}).hex()
    told = peer.ask(
        "query", service=SET_LIVE.name, kind=SET_BOOL, data=request, attachment=asked.pack().hex()
    )
    reply = attachment(bytes.fromhex(told["attachment"]))
    assert (reply.number, reply.gid) == (77, asked.gid) and reply.time_ns > asked.time_ns
    assert decode(f"{SET_BOOL}_Response", bytes.fromhex(told["data"]))["success"]


def test_a_request_that_cannot_be_read_asks_for_nothing_and_is_refused_in_words(us: Us, peer: Peer) -> None:
    us.asked.clear()
    beside = ZenohAttachment(1, 1, bytes(16)).pack().hex()
    for data in ("", "00010000", "ffff000001", "00010000" + "01" * 20):
        told = peer.ask("query", service=SET_LIVE.name, kind=SET_BOOL, data=data, attachment=beside)
        answer = decode(f"{SET_BOOL}_Response", bytes.fromhex(told["data"]))
        assert answer["success"] is False and answer["message"]
    for wrong in (None, "00" * 33):
        told = peer.ask("query", service=SET_LIVE.name, kind=SET_BOOL, data="0001000001", attachment=wrong)
        assert "no attachment" in told["error"]
    assert us.asked == []


@pytest.mark.parametrize("service", [TO_STOP, TO_E_STOP])
@pytest.mark.parametrize("beside", [None, "00" * 33, ZenohAttachment(1, 1, bytes(16)).pack().hex()])
@pytest.mark.parametrize("data", ["", "00010000", "0007000000", "ff" * 40])
def test_a_stop_is_a_stop_whatever_its_bytes(
    us: Us, peer: Peer, service: RosService, beside: str | None, data: str
) -> None:
    us.asked.clear()
    told = peer.ask("query", service=service.name, kind=TRIGGER, data=data, attachment=beside)
    assert us.asked == [(service, None)]
    assert decode(f"{TRIGGER}_Response", bytes.fromhex(told["data"]))["success"]


def test_a_second_e_stop_does_not_wait_behind_one_that_hangs(us: Us, router: Router) -> None:
    us.hold.clear()
    us.asked.clear()
    us.held = TO_E_STOP
    asking: list[threading.Thread] = []
    query = {"service": TO_E_STOP.name, "kind": TRIGGER, "data": "", "attachment": None}
    try:
        with Peer(router.endpoint) as first, Peer(router.endpoint) as second:
            for number, peer in enumerate((first, second), 1):
                until(lambda peer=peer: peer.ask("endpoints", kind="SS"), PATIENCE, "services are seen")
                asking.append(threading.Thread(target=lambda peer=peer: peer.ask("query", **query)))
                asking[-1].start()
                until(lambda number=number: len(us.asked) == number, PATIENCE, f"e-stop {number} is asked")
            us.hold.set()
            for thread in asking:
                thread.join(PATIENCE)
    finally:
        us.hold.set()
        us.held = SET_LIVE


def test_a_fault_in_one_message_or_request_is_reported_and_the_next_is_handled(us: Us, peer: Peer) -> None:
    stop = {"service": TO_STOP.name, "kind": TRIGGER, "data": "", "attachment": None}
    message = {"topic": TRAJECTORY.name, "kind": JOINT_TRAJECTORY, "data": "00010000", "attachment": None}
    for fails in (True, False):
        us.fails = fails
        us.heard.clear()
        peer.ask("raw", **message)
        until(lambda: us.heard, PATIENCE, "the message comes")
        for _ in range(5):  # whichever thread of those that answer stops
            answer = decode(f"{TRIGGER}_Response", bytes.fromhex(peer.ask("query", **stop)["data"]))
            assert answer["success"] is not fails and ("a fault of ours" in answer["message"]) is fails
    assert f"zenoh: {TRAJECTORY.name}: a message was lost: OSError: a fault of ours" in us.told
    assert f"zenoh: {TO_STOP.name}: OSError: a fault of ours" in us.told


def test_a_stop_does_not_wait_behind_a_service_that_takes_long(us: Us, router: Router) -> None:
    us.hold.clear()
    us.asked.clear()
    with Peer(router.endpoint) as slow, Peer(router.endpoint) as quick:
        until(lambda: quick.ask("endpoints", kind="SS"), PATIENCE, "services are seen")
        waiting = threading.Thread(
            target=lambda: slow.ask("call", service=SET_LIVE.name, kind=SET_BOOL, request={"data": True})
        )
        waiting.start()
        until(lambda: us.asked, PATIENCE, "the slow one is asked")
        empty = {"structure_needs_at_least_one_member": 0}
        assert quick.ask("call", service=TO_E_STOP.name, kind=TRIGGER, request=empty)["success"]
        assert waiting.is_alive()
        us.hold.set()
        waiting.join(PATIENCE)
