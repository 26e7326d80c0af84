"""A real front whose loop grants changes, refuses them or says nothing: it goes by the loop's word alone."""

import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from tests.support.loop_stand_in import StandIn
from tests.support.processes import until
from tests.support.raw_connection import Raw, code
from tests.support.reload_rig import briefed, files
from twind import link
from twind.briefing import Briefing
from twind.front import reload_queue
from twind.front.reload_worker import with_settings
from twind.robot.finding import Finding, ReasonCode

LINE = "head_yaw:         {id: 1, limits_rad: [-1.5, 1.5]"
NARROW = {LINE: "head_yaw:         {id: 1, limits_rad: [-0.3, 0.3]"}
KEY = "joints.head_yaw.limits_rad"


@pytest.fixture
def loop(tmp_path: Path) -> Iterator[StandIn]:
    told = briefed(files(tmp_path))
    stand_in = StandIn(tmp_path, given_briefing=told, goal=np.zeros(24).tobytes())
    stand_in.await_lookahead()
    yield stand_in
    assert stand_in.close() == 0
    assert "_BROKE" not in stand_in.log.read_text()


def granted(command: link.Inward) -> list[link.Reply]:
    assert isinstance(command, link.ApplyChanges)
    return [
        link.Reply(
            ticket=command.ticket, parameters={"applied": sorted(command.changes), "needs_restart": []}
        )
    ]


def path(points: int) -> dict[str, Any]:
    rows = [
        {"positions": [-0.3 * (place % 2), 0.3 * (place % 3)], "time_from_start": (place + 1) * 0.02}
        for place in range(points)
    ]
    return {"joint_names": ["l_elbow", "l_shoulder_yaw"], "points": rows}


def limits(client: Raw) -> list[float]:
    joints = client.call("GetRobot")["parameters"]["robot"]["joints"]
    return next([joint["lower"], joint["upper"]] for joint in joints if joint["name"] == "head_yaw")


@contextmanager
def narrowing(loop: StandIn, folder: Path, *points: int) -> Iterator[tuple[Raw, Raw, link.ApplyChanges]]:
    """A connection with paths, the first sent back by the reload of another; that one, its command."""
    loop.answers[link.ApplyChanges] = lambda _: []  # until the path is being swept
    files(folder, robot=NARROW)
    with Raw(loop) as busy, Raw(loop) as other:
        other.send("Reload", parameters={})
        adopt = loop.await_message(lambda command: isinstance(command, link.ApplyChanges), 15.0)
        assert isinstance(adopt, link.ApplyChanges)
        for each in points:
            busy.send("Check", parameters={"trajectory": path(each)})
        time.sleep(0.05)
        loop.send(*granted(adopt))
        assert other.receive()["parameters"] == {"applied": [KEY], "needs_restart": []}
        assert code(busy.receive()) == "CMD_EXPIRED"
        yield busy, other, adopt


def test_with_the_loop_s_word_the_front_changes_and_paths_on_their_way_are_sent_back(
    loop: StandIn, tmp_path: Path
) -> None:
    with narrowing(loop, tmp_path, 2000) as (busy, other, adopt):
        assert not [command for command in loop.commands if isinstance(command, link.Submit)]
        assert limits(other) == [-0.3, 0.3]
        busy.call("Check", trajectory=path(2))
    assert (adopt.generation, adopt.changes) == (1, {KEY: [-0.3, 0.3]})
    told = [msgspec.msgpack.decode(data, type=Briefing) for data in loop.paths if b"generation" in data]
    assert [each.generation for each in told] == [1]
    last = [command for command in loop.commands if isinstance(command, link.Submit)][-1]
    assert last.generation == 1


def test_a_path_that_waits_behind_one_sent_back_is_judged_by_the_new_limits(
    loop: StandIn, tmp_path: Path
) -> None:
    """It begins in the moment in which the one ahead of it on its connection is sent back."""
    with narrowing(loop, tmp_path, 2000, 2) as (busy, _, _):
        assert "error" not in busy.receive()
    (submit,) = [command for command in loop.commands if isinstance(command, link.Submit)]
    assert (submit.points, submit.generation) == (2, 1)


def test_without_the_loop_s_word_the_front_goes_by_the_old_values(loop: StandIn, tmp_path: Path) -> None:
    finding = Finding(ReasonCode.BUSY, message="torque is on")
    loop.answers[link.ApplyChanges] = lambda command: [
        link.Reply(
            ticket=command.ticket, error="Refused", parameters={"findings": [msgspec.to_builtins(finding)]}
        )
    ]
    files(tmp_path, "log_level: debug\n", NARROW)
    with Raw(loop) as client:
        before = client.call("GetRobot"), client.call("GetParameters")
        answer = client.call("Reload")
        assert [each["code"] for each in answer["parameters"]["findings"]] == ["BUSY"]
        assert (client.call("GetRobot"), client.call("GetParameters")) == before
        client.call("Check", trajectory=path(2))
    submit = loop.await_command(link.Submit)
    assert isinstance(submit, link.Submit)
    assert submit.generation == 0


def test_a_refused_settings_file_is_reported_to_the_loop_and_to_the_caller(
    loop: StandIn, tmp_path: Path
) -> None:
    files(tmp_path, "mode: fast\n")
    with Raw(loop) as client:
        answer = client.call("Reload")
    assert [each["code"] for each in answer["parameters"]["findings"]] == ["CONFIG_REFUSED"]
    failed = loop.await_command(link.ReloadFailed)
    assert isinstance(failed, link.ReloadFailed)
    assert f"{tmp_path}/twind.yaml:3:1: " in failed.message
    kinds = [type(command) for command in loop.commands]
    assert kinds.index(link.ReloadStarted) < kinds.index(link.ReloadFailed)
    assert link.ApplyChanges not in kinds


@pytest.mark.slow
def test_a_loop_without_a_reply_to_new_values_gets_another_front_process(tmp_path: Path) -> None:
    """It may have taken the values: a front that does not know goes; the next is told what is in force."""
    stand_in = StandIn(tmp_path, given_briefing=briefed(files(tmp_path)))
    stand_in.answers[link.ApplyChanges] = lambda _: []
    stand_in.await_lookahead()
    files(tmp_path, "log_level: debug\n")
    stand_in.send(link.ReloadWanted())
    stand_in.await_message(lambda command: isinstance(command, link.ApplyChanges), 10.0)
    assert stand_in.front.wait(reload_queue.ANSWER + 5.0) == 0
    assert "LOOP_SILENT" in stand_in.log.read_text()
    stand_in.close()


@pytest.mark.parametrize("first", [True, False], ids=["the first", "a later one"])
def test_a_change_without_descriptors_is_refused_and_the_next_one_is_made(
    loop: StandIn, *, first: bool
) -> None:
    """No change is left half made, which would keep all others waiting or end this front process."""
    loop.answers[link.ApplyChanges] = granted
    least = 3  # every number up to it is taken
    usual = resource.prlimit(loop.front.pid, resource.RLIMIT_NOFILE)
    with Raw(loop) as client:
        assert "error" not in client.call("GetStatus")
        if not first:
            assert "error" not in client.call("SetParameters", parameters={"log_level": "warning"})
        resource.prlimit(loop.front.pid, resource.RLIMIT_NOFILE, (least, usual[1]))
        answer = client.call("SetParameters", parameters={"log_level": "info"})
        assert code(answer) == "CONFIG_REFUSED"
        resource.prlimit(loop.front.pid, resource.RLIMIT_NOFILE, usual)
        made = client.call("SetParameters", parameters={"log_level": "debug"})
        assert made["parameters"]["parameters"]["log_level"] == "debug"
        time.sleep(reload_queue.ANSWER + 0.5)
        assert "error" not in client.call("GetStatus")


GAINS = "types.xm430.gains"
OF_FILE = {"p": 1600, "i": 0, "d": 0}
TRIED = {"p": 900, "i": 0, "d": 20}


def gains(client: Raw) -> dict[str, int]:
    found: dict[str, int] = client.call("GetRobot")["parameters"]["robot"]["joints"][0]["type"]["gains"]
    return found


def test_gains_that_a_client_tries_go_with_its_connection(loop: StandIn) -> None:
    loop.answers[link.ApplyChanges] = granted
    with Raw(loop) as watching:
        with Raw(loop) as client:
            assert "error" not in client.call("SetParameters", parameters={GAINS: TRIED})
            assert gains(watching) == TRIED
        time.sleep(1.0)
        assert gains(watching) == TRIED, "under torque they stay"
        loop.armed = False
        until(lambda: gains(watching) == OF_FILE, 10.0, "the gains of the file")
    sent = [command for command in loop.commands if isinstance(command, link.ApplyChanges)]
    assert [command.changes for command in sent] == [{GAINS: TRIED}, {GAINS: OF_FILE}]
    assert sent[0].client != 0 and sent[1].client == 0 and not any(command.reread for command in sent)


def trying(loop: StandIn, client: Raw) -> None:
    """Let a client that holds the lease try gains, at rest."""
    loop.answers[link.ApplyChanges] = granted
    assert "error" not in client.call("SetParameters", parameters={GAINS: TRIED})
    sent = [command for command in loop.commands if isinstance(command, link.ApplyChanges)]
    loop.lease_client = sent[-1].client
    assert sent[-1].on_trial
    time.sleep(0.3)  # until an overview has told it
    loop.armed = False


def test_a_setting_of_another_client_does_not_make_the_gains_its_own(loop: StandIn) -> None:
    with Raw(loop) as watching, Raw(loop) as other:
        with Raw(loop) as client:
            trying(loop, client)
            assert "error" not in other.call("SetParameters", parameters={"log_level": "info"})
            time.sleep(1.0)
            assert gains(watching) == TRIED
        until(lambda: gains(watching) == OF_FILE, 10.0, "the gains of the file")


def test_gains_stay_when_another_client_that_set_something_ends(loop: StandIn) -> None:
    with Raw(loop) as watching, Raw(loop) as client:
        trying(loop, client)
        with Raw(loop) as other:
            other.call("SetParameters", parameters={"log_level": "info"})
        time.sleep(1.0)
        assert gains(watching) == TRIED


def test_gains_under_trial_end_with_the_lease_of_their_client(loop: StandIn) -> None:
    with Raw(loop) as watching, Raw(loop) as client:
        trying(loop, client)
        time.sleep(0.6)
        assert gains(watching) == TRIED
        loop.lease_client = 0
        until(lambda: gains(watching) == OF_FILE, 10.0, "the gains of the file")


def test_gains_that_may_not_go_back_yet_are_put_back_later(loop: StandIn) -> None:
    loop.answers[link.ApplyChanges] = granted
    refusals = iter([True, False])

    def armed_at_first(command: link.Inward) -> list[link.Reply]:
        if not next(refusals, False):
            return granted(command)
        finding = Finding(ReasonCode.BUSY, message="torque is on")
        told = {"findings": [msgspec.to_builtins(finding)]}
        assert isinstance(command, link.ApplyChanges)
        return [link.Reply(ticket=command.ticket, error="Refused", parameters=told)]

    loop.armed = False
    with Raw(loop) as watching:
        with Raw(loop) as client:
            client.call("SetParameters", parameters={GAINS: TRIED})
            loop.answers[link.ApplyChanges] = armed_at_first
        until(lambda: gains(watching) == OF_FILE, 10.0, "the gains of the file")
    assert next(refusals, None) is None


def test_a_new_front_process_puts_gains_back_that_an_earlier_client_tried(tmp_path: Path) -> None:
    tried = with_settings(briefed(files(tmp_path)), {GAINS: TRIED})
    stand_in = StandIn(tmp_path, given_briefing=tried, goal=np.zeros(24).tobytes())
    stand_in.armed = False
    stand_in.answers[link.ApplyChanges] = granted
    sent = stand_in.await_message(lambda command: isinstance(command, link.ApplyChanges), 15.0)
    assert isinstance(sent, link.ApplyChanges)
    assert (sent.changes, sent.generation) == ({GAINS: OF_FILE}, tried.generation + 1)
    stand_in.close()


@pytest.mark.parametrize(
    "wrong",
    [{"p": 900}, {"p": -1, "i": 0, "d": 0}, {"p": 20000, "i": 0, "d": 0}, {"p": "x", "i": 0, "d": 0}, 3],
)
def test_gains_that_the_file_may_not_have_change_nothing(loop: StandIn, wrong: Any) -> None:
    with Raw(loop) as client:
        answer = client.call("SetParameters", parameters={GAINS: wrong})
        assert [each["code"] for each in answer["parameters"]["findings"]] == ["CONFIG_REFUSED"]
        assert "error" in client.call("SetParameters", parameters={"types.none.gains": TRIED})
        assert gains(client) == OF_FILE
    assert not [command for command in loop.commands if isinstance(command, link.ApplyChanges)]
