"""`twindctl uplink` as a process, between a daemon and a router: what is told, asked and commanded."""

import json
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from tests.support.doctor_rig import way_to
from tests.support.processes import until
from tests.support.uplink_rig import (
    JOINT,
    PATIENCE,
    Far,
    NetworkConfig,
    Site,
    Uplink,
    ended,
    phases,
    site,
    up,
)
from twind.bridge.uplink.remote_contract import MOST
from twind.bridge.zenoh.zenoh_keys import ASKED, STOPS
from twind.client import Client
from twind.protocol import CONTROL, load

Brief = Callable[[Uplink], Uplink]

# Once all is read: nobody may enter the folders of a Python that is root's.
AS_NOBODY = """
import argparse, os, sys
from twind.bridge.uplink import robot_uplink, uplink_command
from twind.command_line.common_options import add_common_options
parser = argparse.ArgumentParser()
add_common_options(parser, None)
uplink_command.add_arguments(parser)
options = parser.parse_args([word for word in sys.argv[1:] if word != "uplink"])
os.setgroups([]), os.setegid(65534), os.seteuid(65534)
sys.exit(uplink_command.run(options))
"""


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory, blank_messages: None) -> Iterator[Site]:
    with site(tmp_path_factory.mktemp("site")) as made:
        yield made


@pytest.fixture
def far(here: Site) -> Iterator[Far]:
    """Nothing moves, nobody has the lease, and nobody listens."""
    until(lambda: here.daemon.status()["lease"] is None, PATIENCE, "the lease is free")
    yield here.far
    here.far.deaf()


@pytest.fixture
def brief() -> Iterator[Brief]:
    """For uplinks that end with the test."""
    with ended() as one:
        yield one


def watchers(sockets: Path) -> int:
    """Connections of observe.sock."""
    rows = [line.split() for line in Path("/proc/net/unix").read_text().splitlines()[1:]]
    return sum(row[5] == "03" and row[7:] == [str(sockets / "observe.sock")] for row in rows)


def findings(answer: dict[str, Any]) -> set[str]:
    return {each["code"] for each in answer["parameters"]["findings"]}


def test_state_is_published_unchanged_and_only_with_a_remote_subscriber(here: Site, far: Far) -> None:
    run = here.daemon.sockets
    until(lambda: watchers(run) == 1, PATIENCE, "the news alone are followed")
    heard = far.listen("state", "10")
    until(lambda: len(heard) > 5, PATIENCE, "the state")
    assert watchers(run) == 2
    messages = [json.loads(each) for each in heard]
    numbers = [each["parameters"]["sequence"] for each in messages]
    assert all(0 < after - number <= 12 for number, after in pairwise(numbers)), numbers
    for each in messages:
        assert each["continues"] is True
        load(CONTROL).methods["Monitor"].results.check(each["parameters"], "")
        assert len(each["parameters"]["joints"]) == 24
    far.deaf()
    until(lambda: watchers(run) == 1, PATIENCE, "the daemon is left alone")


def test_news_go_out_by_topic(here: Site, far: Far) -> None:
    events = far.listen("news", "events")
    latency = far.listen("news", "latency")
    status = far.listen("news", "status")
    until(lambda: latency and status, PATIENCE, "what is told now and then")
    with here.daemon.client() as client:
        client.call("Mark", kind="note", text="said here, heard there")
    until(lambda: events, PATIENCE, "an event")
    assert "said here, heard there" in events[-1].decode()
    assert {json.loads(each)["parameters"]["topic"] for each in latency} == {"latency"}


def test_allowed_queries_are_answered_by_the_daemon_and_others_get_no_reply(far: Far) -> None:
    assert far.ask("ask", "GetStatus")["status"]["mode"] == "sim"
    assert far.ask("ask", "GetRobot")["robot"]["name"] == "h24"
    point = {"positions": [30.0], "time_from_start": 1.0}
    checked = far.ask("check", trajectory={"joint_names": [JOINT], "points": [point]})
    assert "POS_LIMIT" in {each["code"] for each in checked["verdict"]["refusals"]}
    others = set(load(CONTROL).methods) - set(ASKED) - set(STOPS)
    assert {"Check", "Arm", "SetMode", "WriteRegister", "Setpoint", "SubmitTrajectory"} <= others
    for method in others:
        assert far.ask("ask", method) == far.ask("stop", method) == {}, method


def test_an_invalid_query_gets_a_reply_that_names_the_error(far: Far) -> None:
    wrong = far.ask("ask", "GetStatus", data=b"{")
    assert wrong["error"].endswith("InvalidParameter")
    assert far.ask("ask", "GetStatus", joint=True)["parameters"]["parameter"] == "joint"
    assert far.ask("lease", op="steal")["parameters"]["parameter"] == "op"
    assert far.ask("goal", goal="g")["error"].endswith("InvalidParameter")
    assert far.ask("lease", data=b"x" * 70_000)["error"].endswith("InvalidParameter")
    assert far.ask("ask", "GetStatus")["status"]["mode"] == "sim"


def test_the_lease_has_one_holder_local_or_remote(here: Site, far: Far) -> None:
    first = far.lease("first")
    assert first["holder"] == "first" and abs(first["now"] - time.monotonic()) < PATIENCE
    refused = far.lease("second")
    assert refused["error"].endswith("LeaseHeld") and refused["parameters"]["lease"]["holder"] == "first"
    assert far.lease("second", take=True)["parameters"]["parameter"] == "deadline"
    second = far.lease("second", take=True, deadline=refused["parameters"]["now"] + 1.0)
    assert findings(far.ask("lease", op="renew", lease=first["lease"])) == {"LEASE_MISSING"}
    assert findings(far.goal("late", first["lease"], 0.1, 1.0)) == {"LEASE_MISSING"}
    assert far.ask("lease", op="release", lease=second["lease"])["expires_in"] == 0.0
    with here.daemon.client() as client:
        client.call("AcquireLease")
        assert far.lease()["error"].endswith("LeaseHeld"), "somebody beside the robot has it"
        taken = far.lease(take=True, deadline=second["now"] + PATIENCE)
        assert taken["error"].endswith("LeaseHeld"), "and nobody wrests it from him out of sight"


def test_a_repeated_goal_runs_once_and_reports_its_outcome(far: Far) -> None:
    accepted = far.listen("news", "trajectories")
    told = far.listen("goals", "*")
    with far.holding() as lease:
        first = far.goal("bend", lease, 0.3, 1.5)
        assert first["phase"] == "accepted" and first["verdict"]["refusals"] == []
        again = far.goal("bend", lease, 0.9, 1.5)
        assert again["id"] == first["id"]
        until(lambda: "succeeded" in phases(told), PATIENCE, f"it ends: {told}")
        assert far.goal("bend", lease, 0.9, 1.5)["phase"] == "succeeded"
        assert far.knee() == pytest.approx(0.3, abs=0.02)
    shares = [json.loads(each)["progress"] for each in told]
    assert phases(told)[:-1] == ["running"] * (len(told) - 1) and len(told) > 3
    assert shares == sorted(shares) and shares[-1] == 1.0
    assert len(accepted) == 1
    stranger = far.goal("bend", "another lease", 0.9, 1.5)
    assert "used once" in stranger["parameters"]["message"]


def test_a_goal_refused_by_the_gate_has_its_findings_and_stays_refused(far: Far) -> None:
    with far.holding() as lease:
        for _ in range(2):
            refused = far.goal("break", lease, 30.0, 60.0)
            assert "POS_LIMIT" in findings(refused)
            assert {each["message"] for each in refused["parameters"]["findings"]} == {"x"}, "blank_messages"
        assert far.goal("twist/**", lease, 0.1, 1.0)["parameters"]["parameter"] == "goal"
        assert findings(far.goal("yesterday", lease, 0.1, 1.0, ahead=-0.01)) == {"CMD_EXPIRED"}
        assert far.goal("tomorrow", lease, 0.1, 1.0, ahead=3600.0)["parameters"]["parameter"] == "deadline"


def test_a_newer_goal_takes_the_place_of_the_one_that_runs(far: Far) -> None:
    told = far.listen("goals", "older")
    with far.holding() as lease:
        far.goal("older", lease, 0.6, 20.0)
        far.goal("newer", lease, 0.2, 1.0)
        until(lambda: phases(told)[-1:] == ["replaced"], PATIENCE, f"the older one: {told}")
        until(lambda: far.goal("newer", lease, 0, 0)["phase"] == "succeeded", PATIENCE, "the newer one")


def test_a_lease_without_renewal_aborts_the_motion_and_reports_it(far: Far) -> None:
    told = far.listen("goals", "slow")
    lease = far.lease()["lease"]
    assert far.goal("slow", lease, far.knee() + 0.5, 15.0)["phase"] == "accepted"
    until(lambda: phases(told)[-1:] == ["aborted"], PATIENCE, f"nobody renews: {told}")
    assert {each["code"] for each in json.loads(told[-1])["findings"]} == {"LEASE_LOST"}
    assert json.loads(told[-1])["progress"] < 0.6
    assert findings(far.ask("lease", op="renew", lease=lease)) == {"LEASE_MISSING"}
    assert far.ask("ask", "GetStatus")["status"]["motion"] != "active"


def test_a_client_without_the_lease_can_stop_the_motion(far: Far) -> None:
    told = far.listen("goals", "stopped")
    with far.holding() as lease:
        far.goal("stopped", lease, 0.1, 20.0)
        assert far.ask("stop", "Cancel")["state"] == "disconnected"
        until(lambda: phases(told)[-1:] == ["cancelled"], PATIENCE, f"stopped: {told}")


@contextmanager
def flood(here: Site, data: bytes, *key: str) -> Iterator[list[int]]:
    """Somebody asks that flat out until the end; how many were sent, and how many answered, errors too."""
    count = [0, 0]
    stop = threading.Event()
    peer = Far(NetworkConfig(connect=(here.router.endpoint,)), here.far.robot)

    def answered(reply: Any) -> None:
        count[1] += 1

    def ask() -> None:
        while not stop.is_set():
            for _ in range(40):
                peer.session.get(peer.key(*key), answered, payload=data, timeout=PATIENCE)
                count[0] += 1
            stop.wait(0.02)

    thread = threading.Thread(target=ask)
    thread.start()
    try:
        until(lambda: count[1] > 200, PATIENCE, "it is a flood")
        yield count
    finally:
        stop.set()
        thread.join()
        peer.close()


GARBAGE = b'{"level":"nonsense","op":"steal"}'


@pytest.mark.parametrize(
    ("data", "key"),
    [
        (GARBAGE, "stop/EStop"),
        (b"{}", "stop/EStop"),
        (GARBAGE, "stop/Cancel"),
        (b"{}", "stop/Cancel"),
        (GARBAGE, "lease"),
        (b"{}", "ask/GetStatus"),
    ],
)
def test_a_flood_neither_blocks_nor_defers_a_stop(here: Site, far: Far, data: bytes, key: str) -> None:
    try:
        with flood(here, data, *key.split("/")):
            for level in ("settle", "cut") * 3:
                assert far.ask("stop", "EStop", reason="too much", level=level).get("state") == "estop"
                assert far.ask("stop", "Cancel").get("state") == "estop"
    finally:
        with here.daemon.client() as client:
            client.call("Reset")


def test_a_flood_of_invalid_bytes_does_not_prevent_a_lease_renewal(here: Site, far: Far) -> None:
    told = far.listen("goals", "unhurried")
    with flood(here, GARBAGE, "lease"), far.holding() as lease:
        assert far.goal("unhurried", lease, 0.25, 2.0).get("phase") == "accepted"
        until(lambda: phases(told)[-1:] not in ([], ["running"]), PATIENCE, "it ends")
    assert phases(told)[-1] == "succeeded"


def test_a_flood_of_queries_is_answered_with_refusals(far: Far) -> None:
    answers: list[Any] = []
    get = far.session.get
    key = far.key("ask", "GetStatus")
    for _ in range(400):
        get(key, lambda reply: answers.append(bool(reply.ok)), payload=b"{}", timeout=PATIENCE)
    until(lambda: len(answers) == 400, PATIENCE, "every question gets an answer")
    assert answers.count(False) > 100 and answers.count(True) >= 64


def test_an_oversized_query_is_refused_before_it_takes_memory(here: Site, far: Far) -> None:
    before = memory(here.uplink)
    for key, size in (("check", MOST + 1), ("ask/GetStatus", MOST), ("stop/EStop", MOST)):
        for _ in range(20):
            refused = far.ask(*key.split("/"), data=b" " * size)
            assert f"{size} bytes, bound" in refused["parameters"]["message"], key
    answers: list[Any] = []
    for _ in range(40):
        far.session.get(far.key("check"), answers.append, payload=b" " * MOST, timeout=PATIENCE)
    until(lambda: len(answers) == 40, PATIENCE, "every question gets an answer")
    assert far.ask("ask", "GetStatus")["status"]["mode"] == "sim"
    grown = memory(here.uplink) - before
    print(f"{grown >> 20} MB more, at most")
    assert grown < 150 << 20, "the unit has 256 MB, and 64 are taken"


def memory(uplink: Uplink) -> int:
    """The most that it ever had, bytes."""
    said = Path(f"/proc/{uplink.process.pid}/status").read_text()
    return 1024 * int(said.partition("VmHWM:")[2].split()[0])


def test_a_flood_of_checks_does_not_use_up_the_rate_of_goals(far: Far) -> None:
    """The daemon takes twenty trajectories a second of one peer, checks and goals alike: 20 checks flat out
    would have had the goals behind them refused."""
    answers: list[bool] = []
    point = {"positions": [0.1], "time_from_start": 1.0}
    payload = json.dumps({"trajectory": {"joint_names": [JOINT], "points": [point]}}).encode()
    get = far.session.get
    key = far.key("check")
    with far.holding() as lease:
        for number in range(20):
            for _ in range(5):
                get(key, lambda reply: answers.append(bool(reply.ok)), payload=payload, timeout=PATIENCE)
            answer = far.goal(f"beside{number}", lease, 0.1, 1.0)
            assert answer.get("phase") == "accepted", answer
            time.sleep(0.08)
    until(lambda: len(answers) == 100, PATIENCE, "every question gets an answer")
    assert answers.count(True) >= 8 and answers.count(False) > 50


def test_a_name_that_is_taken_is_refused_in_words(here: Site, brief: Brief) -> None:
    other = brief(Uplink(here.daemon.sockets, "--connect", here.router.endpoint, "--name", "robot"))
    assert other.process.wait(PATIENCE) == 1
    out, _ = other.process.communicate()
    assert "'robot' is alive on this network already" in json.loads(out)["parameters"]["message"]


def test_without_a_name_it_has_the_robots_own_and_ends_with_its_token(here: Site, brief: Brief) -> None:
    other = brief(Uplink(here.daemon.sockets, "--connect", here.router.endpoint))
    elsewhere = Far(NetworkConfig(connect=(here.router.endpoint,)), "h24")
    up(elsewhere, other)
    elsewhere.ask("ask", "GetStatus")
    begun = time.monotonic()
    code, out = other.end()
    took = time.monotonic() - begun
    assert code == 0 and json.loads(out)["lanes"]["asking"]["answered"] == 1
    assert not elsewhere.there()
    elsewhere.close()
    print(f"ended within {took:.2f} s")


def test_an_uplink_without_command_permission_grants_no_remote_commands(here: Site, brief: Brief) -> None:
    if os.geteuid() != 0:
        pytest.skip("root alone can be somebody else")
    run = here.daemon.sockets
    for folder in way_to(run):
        folder.chmod(0o755)
    (run / "observe.sock").chmod(0o666)
    (run / "control.sock").chmod(0o600)
    other = brief(Uplink(run, "--connect", here.router.endpoint, "--name", "seen", program=("-c", AS_NOBODY)))
    elsewhere = Far(NetworkConfig(connect=(here.router.endpoint,)), "seen")
    up(elsewhere, other)
    assert elsewhere.ask("ask", "GetStatus")["status"]["mode"] == "sim"
    refused = elsewhere.lease()
    assert refused["error"] == "io.twind.Uplink.NoDaemon" and "permission" in refused["parameters"]["message"]
    until(lambda: "no remote client can command" in other.output, PATIENCE, "said here too")
    assert other.output.count("permission denied") == 1
    assert elsewhere.ask("stop", "EStop")["state"] == "estop", "a stop needs no right"
    elsewhere.close()
    with Client(run) as client:
        client.call("Reset")
