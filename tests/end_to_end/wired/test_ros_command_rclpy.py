"""`twindctl ros --backend rclpy` beside a daemon, met by a node of another process.

By the real rclpy where it is here (`make ros`), and by a stand-in under each Python that a distribution has.
"""

import json
import time
from collections.abc import Iterator
from math import atan2
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.support.processes import Daemon, simulated, until
from tests.support.ros_graphs import REAL, Bridge, Graph, Peer, here

OLDEST = "3.10"  # of Humble
# action_msgs/msg/GoalStatus
SUCCEEDED = 4
CANCELED = 5
ABORTED = 6


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    with simulated(tmp_path_factory.mktemp("run")) as daemon:
        yield daemon


@pytest.fixture(scope="module", params=[here(), REAL])
def graph(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    graph = Graph(request.param, tmp_path_factory.mktemp("graph"))
    try:
        yield graph
    finally:
        graph.close()


@pytest.fixture(scope="module")
def bridge(graph: Graph, daemon: Daemon) -> Bridge:
    return graph.bridge(daemon.sockets)


@pytest.fixture(scope="module")
def peer(graph: Graph, bridge: Bridge) -> Peer:
    peer = graph.peer()
    for topic, kind in (("/joint_states", "JointState"), ("/bridge/results", "String")):
        peer.hear(topic=topic, kind=kind)
    peer.newest(topic="/joint_states")
    return peer


def at(peer: Peer, joint: str) -> float:
    """Position of a joint on /joint_states."""
    state = peer.newest(topic="/joint_states")
    return float(state["position"][state["name"].index(joint)])


def results(peer: Peer, *wanted: str) -> list[dict[str, str]]:
    """The results of the next command, up to its end; earlier ones are none of it."""
    told = [json.loads(peer.next(topic="/bridge/results")) for _ in wanted]
    assert [each["phase"] for each in told] == list(wanted), told
    return told


def move(peer: Peer, joint: str, place: float, **more: float) -> None:
    peer.say(topic="/cmd/joint_trajectory", joints=[joint], positions=[place], seconds=0.5, **more)


@pytest.mark.parametrize("version", [OLDEST, "3.12", "3.13"])
def test_the_bridge_runs_under_the_python_of_each_distribution(
    version: str, daemon: Daemon, tmp_path: Path
) -> None:
    graph = Graph(version, tmp_path)
    try:
        bridge = graph.bridge(daemon.sockets)
        peer = graph.peer()
        peer.hear(topic="/joint_states", kind="JointState")
        peer.hear(topic="/bridge/results", kind="String")
        assert len(peer.newest(topic="/joint_states")["name"]) == 24
        begun = at(peer, "head_yaw")
        move(peer, "head_yaw", begun + 0.1)
        results(peer, "accepted", "succeeded")
        assert at(peer, "head_yaw") == pytest.approx(begun + 0.1, abs=0.02)
        assert json.loads(peer.ask(service="/bridge/get_status", kind="Trigger")[1])["mode"] == "sim"
        goal = peer.follow(joints=["head_yaw"], positions=[begun], seconds=0.5)
        assert goal[:3] == [SUCCEEDED, 0, ""]
        assert bridge.end()[0] == 0
    finally:
        graph.close()


def test_a_node_finds_it_as_it_finds_any_other(peer: Peer) -> None:
    until(lambda: "twind" in peer.names(), 20.0, "its name")
    state = {"node": "twind", "kind": "sensor_msgs/msg/JointState", "reliable": True, "latched": False}
    assert peer.writers_of(topic="/joint_states") == [state]
    status = {"node": "twind", "kind": "std_msgs/msg/String", "reliable": True, "latched": True}
    assert peer.writers_of(topic="/bridge/status") == [status]


def test_joint_states_carry_the_current_wall_clock_time(peer: Peer) -> None:
    state = peer.newest(topic="/joint_states")
    assert len(state["name"]) == len(state["position"]) == 24
    assert abs(time.time() - state["time"]) < 30.0


def test_a_late_subscriber_receives_the_status(peer: Peer) -> None:
    peer.hear(topic="/bridge/status", kind="String", latched=True)
    assert json.loads(peer.next(topic="/bridge/status"))["mode"] == "sim"


def test_the_graph_has_the_robot_its_frames_and_the_time_of_the_simulation(peer: Peer, graph: Graph) -> None:
    peer.hear(topic="/robot_description", kind="String", latched=True)
    urdf = ElementTree.fromstring(peer.next(topic="/robot_description"))
    assert len(urdf.findall("joint[@type='revolute']")) == 24
    peer.hear(topic="/bridge/latency", kind="Float64")
    assert isinstance(peer.newest(topic="/bridge/latency"), float)
    peer.hear(topic="/clock", kind="Clock")
    first, second = (peer.next(topic="/clock") for _ in range(2))
    assert first < second and abs(time.time() - second) < 30.0
    if not peer.hear(topic="/tf", kind="TFMessage"):
        pytest.skip("tf2_msgs is not among the wheels: /tf is met by the stand-in alone")
    frames = peer.newest(topic="/tf")
    state = peer.newest(topic="/joint_states")
    children = {str(link.get("link")) for link in urdf.iterfind("joint/child")}
    assert {each["child"] for each in frames} == children - {"torso"}
    yaw = next(each for each in frames if each["child"] == "neck")
    angle = 2.0 * atan2(yaw["rotation"][3], yaw["rotation"][0])
    assert angle == pytest.approx(state["position"][state["name"].index("head_yaw")], abs=0.01)
    peer.hear(topic="/tf_static", kind="TFMessage", latched=True)
    assert [each["child"] for each in peer.next(topic="/tf_static")] == ["torso"]


def test_a_trajectory_moves_the_robot_and_the_accepted_trajectory_is_published(peer: Peer) -> None:
    peer.hear(topic="/hw/joint_trajectory", kind="JointTrajectory")
    begun = at(peer, "head_yaw")
    move(peer, "head_yaw", begun + 0.1)
    first, last = results(peer, "accepted", "succeeded")
    assert first["id"] == last["id"]
    assert peer.next(topic="/hw/joint_trajectory") == {"joints": ["head_yaw"], "frame": first["id"]}
    assert at(peer, "head_yaw") == pytest.approx(begun + 0.1, abs=0.02)


def test_a_trajectory_refused_by_the_gate_moves_nothing_and_is_reported(peer: Peer) -> None:
    begun = at(peer, "head_yaw")
    move(peer, "head_yaw", 9.0)
    assert "POS_LIMIT" in results(peer, "refused")[0]["message"]
    move(peer, "head_yaw", begun + 0.1, stamp=time.time() - 86400.0)
    assert "CMD_EXPIRED" in json.dumps(results(peer, "refused"))
    peer.say_bytes(topic="/cmd/joint_trajectory", data="00010000ffffffff00")
    assert "malformed" in results(peer, "refused")[0]["message"]
    assert at(peer, "head_yaw") == pytest.approx(begun, abs=0.01)


def test_the_parameter_mode_is_the_daemons_mode(peer: Peer, daemon: Daemon) -> None:
    until(lambda: peer.mode() == "sim", 20.0, "the parameter follows")
    assert peer.set_mode(mode="mirror") == [True, ""]
    assert daemon.status()["mode"] == "mirror"
    done, why = peer.set_mode(mode="dance")
    assert not done and "sim, mirror, live" in why
    done, why = peer.set_mode(mode="live")
    assert not done and why  # the daemon has no port
    with daemon.client() as client:
        client.call("SetMode", mode="sim")
    until(lambda: peer.mode() == "sim", 20.0, "the parameter follows")


def test_services_answer_and_an_e_stop_by_service_latches(peer: Peer, daemon: Daemon) -> None:
    assert peer.ask(service="/bridge/set_mode_mirror", kind="Trigger") == [True, "mirror"]
    assert peer.ask(service="/bridge/set_mode_sim", kind="Trigger") == [True, "sim"]
    done, why = peer.ask(service="/bridge/set_mode", kind="SetBool", data=True)
    assert not done and why
    assert peer.ask(service="/bridge/stop", kind="Trigger")[0]
    assert peer.ask(service="/bridge/estop", kind="Trigger")[0]
    move(peer, "head_yaw", 0.0)
    assert "ESTOP_LATCHED" in json.dumps(results(peer, "refused"))
    with daemon.client() as client:
        client.call("AcquireLease", take=True)  # the bridge lingers on it for a moment
        client.call("Reset")


def test_a_goal_of_the_action_has_feedback_and_a_result(peer: Peer, graph: Graph, bridge: Bridge) -> None:
    if graph.whose == REAL:
        bridge.says("no action /cmd/follow_joint_trajectory")
        pytest.skip("control_msgs is not among the wheels: the action is met by the stand-in alone")
    begun = at(peer, "head_pitch")
    path = {"joints": ["head_pitch"], "positions": [begun + 0.1], "seconds": 1.0}
    status, code, words, told, difference = peer.follow(**path)
    assert (status, code, words) == (SUCCEEDED, 0, "")
    assert told > 5 and abs(difference[0]) < 0.05
    assert at(peer, "head_pitch") == pytest.approx(begun + 0.1, abs=0.02)


@pytest.mark.parametrize(
    ("more", "status", "code", "words"),
    [
        ({"joints": ["tail"]}, ABORTED, -2, "UNKNOWN_JOINT"),
        ({"positions": [9.0]}, ABORTED, -1, "POS_LIMIT"),
        ({"stamp": 1}, ABORTED, -3, "CMD_EXPIRED"),
        ({"path": 1e-9}, ABORTED, -4, "PATH_TOLERANCE"),
        ({"cancel_after": 0.5, "seconds": 5.0}, CANCELED, 0, ""),
    ],
)
def test_a_failed_goal_reports_its_status_and_cause(
    peer: Peer, graph: Graph, more: dict[str, float], status: int, code: int, words: str
) -> None:
    if graph.whose == REAL:
        pytest.skip("control_msgs is not among the wheels: the action is met by the stand-in alone")
    begun = at(peer, "head_pitch")
    path = {"joints": ["head_pitch"], "positions": [begun - 0.1], "seconds": 1.0} | more
    told = peer.follow(**path)
    assert told[:2] == [status, code]
    assert words in told[2]


def test_a_flood_of_goals_holds_up_no_stop(peer: Peer, graph: Graph) -> None:
    if graph.whose == REAL:
        pytest.skip("control_msgs is not among the wheels: the action is met by the stand-in alone")
    place = at(peer, "head_pitch") + 0.1
    accepted, stopped, codes = peer.follow_many(
        count=7, joints=["head_pitch"], positions=[place], seconds=20.0
    )
    assert accepted[:4] == [True] * 4
    assert stopped
    assert codes == [-1] * sum(accepted)  # replaced, or stopped by somebody else


def test_a_bridge_without_commands_executes_only_e_stops(daemon: Daemon, tmp_path: Path) -> None:
    graph = Graph(here(), tmp_path)
    try:
        graph.bridge(daemon.sockets, "--no-commands")
        peer = graph.peer()
        peer.hear(topic="/joint_states", kind="JointState")
        peer.newest(topic="/joint_states")
        assert peer.serves(service="/bridge/estop")
        done, why = peer.set_mode(mode="mirror")
        assert not done and "--no-commands" in why
        assert daemon.status()["mode"] == "sim"
    finally:
        graph.close()


def test_the_bridge_ends_in_time_on_sigterm(bridge: Bridge, peer: Peer) -> None:
    code, seconds = bridge.end()
    assert code == 0
    assert seconds < 10.0  # 2 are meant, of a machine that has the time
