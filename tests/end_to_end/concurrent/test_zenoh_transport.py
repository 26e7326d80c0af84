"""ROS 2 over Zenoh, with a real router and a peer in another process that shares no code with ours.

Of Zenoh itself both use the one engine there is; names, tokens, types and bytes are zenoh-ros2-sdk's own.
"""

import json
import signal
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
import zenoh

from tests.support.processes import PATIENCE, until
from tests.support.ros_zenoh_node import Us, joined
from tests.support.ros_zenoh_peer import Peer
from tests.support.zenoh_router import Router
from twind.bridge.ros.discovery import DiscoverySettings
from twind.bridge.ros.ros_endpoints import (
    DIAGNOSTICS,
    HW_JOINTS,
    LATENCIES,
    RESULTS,
    SERVICES,
    STATUS,
    STOP,
    TOPICS,
    TRAJECTORY,
    RosTopic,
)
from twind.bridge.ros.ros_trajectory import LONGEST
from twind.bridge.ros.zenoh import ZenohTransport
from twind.bridge.ros.zenoh.zenoh_attachment import attachment
from twind.bridge.ros.zenoh.zenoh_names import gid
from twind.bridge.ros.zenoh.zenoh_node import ZenohWriter
from twind.exceptions import OperationFailed
from twind.ros import FLOATS, JOINT_TRAJECTORY, STRING, JointStateBuffer, decode, encode

pytest.importorskip("zenoh_ros2_sdk", reason="no zenoh-ros2-sdk here (it needs git)")
QUIET = {"multicast": {"enabled": False}}
JOINTS = [f"joint_{place}" for place in range(24)]


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


def received_messages(peer: Peer, topic: RosTopic) -> list[str]:
    return [each["data"] for each in peer.ask("received", topic=topic.name)]


def endpoints(peer: Peer) -> dict[str, dict[str, str]]:
    """Endpoints that the peer sees, by name."""
    told = [each for kind in ("MP", "MS", "SS") for each in peer.ask("endpoints", kind=kind)]
    return {each["qualified_name"]: each for each in told}


def hears(us: Us, peer: Peer, topic: RosTopic) -> None:
    """The peer hears a topic: what is said now comes."""
    peer.ask("hear", topic=topic.name, kind=topic.kind)
    comes(us, peer, topic, "there?")


def comes(us: Us, peer: Peer, topic: RosTopic, text: str) -> None:
    """Said again and again, it is heard: what finds no room on the way is dropped."""

    def came() -> bool:
        us.say(topic, text)
        time.sleep(0.05)
        return text in received_messages(peer, topic)

    until(came, PATIENCE, f"the peer hears {text!r} on {topic.name}")


def test_a_peer_finds_every_endpoint_with_its_name_type_and_quality(us: Us, peer: Peer) -> None:
    expected = {each.name: [each.kind] for each in TOPICS}
    until(lambda: dict(peer.ask("topics")) == expected, PATIENCE, "every topic is listed")
    count = len(expected) + len(SERVICES)
    found = until(lambda: every if len(every := endpoints(peer)) == count else None, PATIENCE, "all are seen")
    assert {(each["node_name"], each["namespace"]) for each in found.values()} == {("twind", "/")}
    assert len({each["entity_id"] for each in found.values()}) == len(found)
    for each in TOPICS:
        told = found[each.name]
        assert told["kind"] == ("MP" if each.out else "MS")
        assert "RELIABLE: 1" in told["qos"] and f"history_depth={each.depth}," in told["qos"]
        assert ("TRANSIENT_LOCAL" in told["qos"]) == each.latched
    assert {name for name, each in found.items() if each["kind"] == "SS"} == {each.name for each in SERVICES}


def test_a_published_message_arrives_unchanged(us: Us, peer: Peer) -> None:
    for topic in (HW_JOINTS, LATENCIES, DIAGNOSTICS):
        peer.ask("hear", topic=topic.name, kind=topic.kind)
    columns = [[place + 0.5 for place in range(24)], [0.25] * 24, [-1.0] * 24]
    state = JointStateBuffer(JOINTS, velocity=True, effort=True, frame="base").fill(
        1_500_000_000_000_000_007, *columns
    )
    dims = [{"label": "hop", "size": 2, "stride": 2}]
    numbers = encode(FLOATS, {"layout": {"dim": dims}, "data": [0.5, 1.5]})
    level = {"level": 1, "name": "bus", "message": "late", "values": [{"key": "age", "value": "3"}]}
    status = encode(DIAGNOSTICS.kind, {"status": [level]})

    def came() -> bool:
        for topic, data in ((HW_JOINTS, state), (LATENCIES, numbers), (DIAGNOSTICS, status)):
            us.node.publish(topic, data)
        time.sleep(0.05)
        return all(peer.ask("received", topic=topic.name) for topic in (HW_JOINTS, LATENCIES, DIAGNOSTICS))

    until(came, PATIENCE, "all three come")
    joints = peer.ask("received", topic=HW_JOINTS.name)[0]
    assert joints["name"] == JOINTS and joints["header"]["frame_id"] == "base"
    assert [joints["header"]["stamp"][part] for part in ("sec", "nanosec")] == [1_500_000_000, 7]
    assert [joints[part] for part in ("position", "velocity", "effort")] == columns
    told = peer.ask("received", topic=LATENCIES.name)[0]
    assert told["data"] == [0.5, 1.5] and told["layout"]["dim"][0]["label"] == "hop"
    assert peer.ask("received", topic=DIAGNOSTICS.name)[0]["status"][0]["values"][0]["value"] == "3"


def test_a_late_subscriber_receives_the_last_latched_message(us: Us, peer: Peer) -> None:
    for text in ("first", "last"):
        us.say(STATUS, text)
    peer.ask("hear_latched", topic=STATUS.name, kind=STRING)
    until(lambda: received_messages(peer, STATUS), PATIENCE, "the last comes")
    assert received_messages(peer, STATUS) == ["last"]
    us.say(STATUS, "new")
    until(
        lambda: received_messages(peer, STATUS) == ["last", "new"],
        PATIENCE,
        "what is said then comes too, once",
    )


def test_a_trajectory_of_the_peer_comes_with_its_nested_points(us: Us, peer: Peer) -> None:
    point = {
        "_": "trajectory_msgs/msg/JointTrajectoryPoint",
        "positions": [0.5, -0.25],
        "velocities": [0.0, 0.0],
    }
    point |= {"accelerations": [0.0], "effort": [0.0]}
    point |= {"time_from_start": {"_": "builtin_interfaces/msg/Duration", "sec": 1, "nanosec": 5}}
    header = {
        "_": "std_msgs/msg/Header",
        "stamp": {"_": "builtin_interfaces/msg/Time", "sec": 3, "nanosec": 4},
    }
    message = {"header": header | {"frame_id": "x"}, "joint_names": ["a", "b"], "points": [point, point]}
    peer.ask("say", topic=TRAJECTORY.name, kind=JOINT_TRAJECTORY, message=message)
    until(lambda: us.heard, PATIENCE, "the trajectory comes")
    topic, data = us.heard.pop()
    told = decode(JOINT_TRAJECTORY, data)
    assert topic == TRAJECTORY and told["joint_names"] == ["a", "b"]
    assert told["header"] == {"stamp": {"sec": 3, "nanosec": 4}, "frame_id": "x"}
    assert [each["positions"] for each in told["points"]] == [[0.5, -0.25]] * 2
    assert told["points"][1]["time_from_start"] == {"sec": 1, "nanosec": 5}


@pytest.mark.parametrize("data", ["", "ff", "00010000", "00010000ffffff7f", "00" * 5000])
@pytest.mark.parametrize("beside", [None, "00"])
def test_any_received_bytes_are_passed_on_unchanged(
    us: Us, peer: Peer, data: str, beside: str | None
) -> None:
    us.heard.clear()
    peer.ask("raw", topic=TRAJECTORY.name, kind=JOINT_TRAJECTORY, data=data, attachment=beside)
    until(lambda: us.heard, PATIENCE, "the bytes come")
    assert us.heard == [(TRAJECTORY, bytes.fromhex(data))]


def test_an_oversized_message_is_cut_and_the_next_arrives(us: Us, peer: Peer) -> None:
    us.heard.clear()

    def send(length: int) -> bool:
        """Send again and return True once a message has come: one without room on the way is dropped."""
        peer.ask("raw", topic=STOP.name, kind=STRING, data="00" * length, attachment=None)
        return bool(us.heard)

    until(lambda: send(LONGEST + 1), PATIENCE, "the first comes")
    send(3 * LONGEST)  # beyond what a session takes from the network at all
    send(4)
    until(lambda: any(len(data) == 4 for _, data in us.heard), PATIENCE, "the last comes")
    assert {len(data) for _, data in us.heard} == {LONGEST + 1, 4}


def test_messages_of_several_threads_go_out_in_the_order_of_their_numbers() -> None:
    class Slow:
        """Channel whose first message takes longest to send."""

        def __init__(self) -> None:
            self.sent: list[int] = []

        def put(self, data: bytes, **beside: bytes) -> None:
            number = attachment(beside["attachment"]).number
            time.sleep(0.3 / number)
            self.sent.append(number)

    channel: Any = Slow()
    writer = ZenohWriter(channel, bytes(16))
    threads = [threading.Thread(target=writer.put, args=(b"x",)) for _ in range(3)]
    for thread in threads:
        thread.start()
        time.sleep(0.02)
    for thread in threads:
        thread.join()
    assert channel.sent == [1, 2, 3]


def test_beside_each_message_are_its_number_its_time_and_the_id_of_its_publishers_token(
    router: Router,
) -> None:
    """Read by a bare session of Zenoh, as a subscription of rmw_zenoh would."""
    config = zenoh.Config.from_json5(
        json.dumps({"mode": "client", "connect": {"endpoints": [router.endpoint]}, "scouting": QUIET})
    )
    domain = 100  # nobody else's
    node = ZenohTransport(DiscoverySettings(domain), lambda line: None, router.endpoint)
    with zenoh.open(config) as session:
        samples = session.declare_subscriber(f"{domain}/bridge/results/**")
        node.open([RESULTS], [], lambda topic, data: None, lambda service, data, reply: None)
        try:
            begun = time.time_ns()
            seen = []
            for _ in range(round(PATIENCE / 0.05)):
                node.publish(RESULTS, encode(STRING, {"data": "x"}))
                time.sleep(0.05)
                while (sample := samples.try_recv()) is not None:
                    seen.append(attachment(sample.attachment.to_bytes()))
                if len(seen) >= 3:
                    break
            replies = session.liveliness().get(f"@ros2_lv/{domain}/**/MP/**", timeout=PATIENCE)
            tokens = [str(reply.ok.key_expr) for reply in replies]
        finally:
            node.close()
    assert len(tokens) == 1 and {each.gid for each in seen} == {gid(tokens[0])}
    numbers = [each.number for each in seen]
    assert numbers == list(range(numbers[0], numbers[0] + len(seen)))
    assert all(begun < each.time_ns <= time.time_ns() for each in seen)


def test_no_joint_state_of_24_joints_is_lost_at_500_hz(us: Us, router: Router) -> None:
    buffer = JointStateBuffer(JOINTS, velocity=True, effort=True)
    rate = 500
    count = rate * 2
    with Peer(router.endpoint) as peer:
        hears(us, peer, RESULTS)
        peer.ask("hear", topic=HW_JOINTS.name, kind=HW_JOINTS.kind)
        time.sleep(0.3)
        begun = time.monotonic()
        for number in range(count):
            us.node.publish(HW_JOINTS, buffer.fill(time.time_ns(), *[[0.1] * 24] * 3))
            time.sleep(max(0.0, begun + (number + 1) / rate - time.monotonic()))
        until(lambda: peer.ask("counted", topic=HW_JOINTS.name)["count"] >= count, PATIENCE, "all come")
        told = peer.ask("counted", topic=HW_JOINTS.name)
    late = [round(told["late"][round(share * (count - 1))] * 1e3, 2) for share in (0.5, 0.99, 1.0)]
    print(f"{rate} Hz: {count} of {count}; p50, p99, max {late} ms")
    assert told["count"] == count


def test_a_peer_that_hangs_holds_up_no_message_to_others(us: Us, router: Router, peer: Peer) -> None:
    hears(us, peer, RESULTS)
    with Peer(router.endpoint) as frozen:
        hears(us, frozen, RESULTS)
        frozen.signal(signal.SIGSTOP)
        slowest = 0.0
        for _ in range(200):  # 12 MB: more than any buffer on the way
            begun = time.monotonic()
            us.say(RESULTS, "x" * 60_000)
            slowest = max(slowest, time.monotonic() - begun)
        print(f"the slowest of 200: {slowest * 1e3:.1f} ms")
        # Of so many some may find no room on the way to either: what comes after them does.
        comes(us, peer, RESULTS, "afterwards")
        frozen.signal(signal.SIGCONT)
    assert slowest < PATIENCE / 10


def test_the_router_may_go_and_come_back(router: Router) -> None:
    with joined(router.endpoint) as us, Peer(router.endpoint) as peer:
        hears(us, peer, RESULTS)
        until(lambda: any("found" in line for line in us.told), PATIENCE, "a router is told")
        us.told.clear()
        router.kill()
        until(lambda: any("lost" in line for line in us.told), PATIENCE, "its loss is told")
        us.say(RESULTS, "without")
        until(lambda: "without" in received_messages(peer, RESULTS), PATIENCE, "who knew each other speak on")
        router.start()
        until(lambda: any("found" in line for line in us.told), PATIENCE, "it is found again")
        with Peer(router.endpoint) as new:
            hears(us, new, RESULTS)


def test_a_router_that_comes_later_is_found() -> None:
    with Router(gossip=True) as router:
        router.kill()
        with joined(router.endpoint) as us:
            assert any("no router" in line for line in us.told)
            us.say(STATUS, "to nobody")
            router.start()
            with Peer(router.endpoint) as peer:
                hears(us, peer, RESULTS)


def test_a_closed_node_leaves_the_graph_at_once_and_can_rejoin(router: Router, peer: Peer) -> None:
    def new() -> set[str]:
        """Sessions that were not there before: those of other tests may still be leaving."""
        return {each["session_id"] for each in peer.ask("endpoints", kind="SS")} - before

    before: set[str] = set()
    before = new()
    with joined(router.endpoint) as us:
        until(lambda: len(new()) == 1, PATIENCE, "one more is seen")
        us.node.close()
        us.node.close()
        until(lambda: not new(), PATIENCE, "it is gone")
        with pytest.raises(OperationFailed, match="/bridge/status: the graph is not joined"):
            us.say(STATUS, "too late")
        us.join()
        until(lambda: len(new()) == 1, PATIENCE, "it is back")
