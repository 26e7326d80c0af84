"""While no new client can connect, the loop holds and refuses motion; stops are carried out as ever."""

import pytest

from tests.support.daemon_rig import MakeRig, Rig
from tests.support.scene_rig import ask, move, reported_codes
from twind import link
from twind.loop.procedures.torque_readback import torque_off
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, Motion, RobotState

GONE = link.Reachable(missing="control.sock: removed")
BACK = link.Reachable()


def report(rig: Rig, news: link.Reachable, ticks: int = 2) -> None:
    """Send the front's report about its sockets."""
    rig.front.outer.send(link.encode(news))
    rig.ticks(ticks)


def refused(rig: Rig, ticket: int) -> list[str]:
    replies = [reply for reply in rig.replies(ticket) if reply.error == "Refused"]
    return [finding["code"] for reply in replies for finding in reply.parameters["findings"]]


def test_a_motion_holds_and_none_begins_until_clients_can_connect_again(armed: Rig) -> None:
    move(armed)
    report(armed, GONE)
    armed.seconds(1.0)
    assert (armed.loop.condition.state, armed.loop.executor.motion) == (RobotState.ARMED, Motion.HOLDING)
    (event,) = armed.events("SOCKETS_GONE")
    assert (event.level, event.message) == ("error", "control.sock: removed")
    ended = [each for each in armed.events("MOTION") if "aborted" in each.message]
    assert [finding.code for finding in ended[-1].findings] == [ReasonCode.SOCKETS_GONE]
    assert armed.loop.publisher.status().endswith("SOCKETS_GONE: control.sock: removed")
    assert ReasonCode.SOCKETS_GONE in [finding.code for finding in armed.loop.publisher.overview(0.0).faults]

    armed.lease()
    ticket = armed.submit(armed.path("head_yaw", [0.2], [1.0]))
    armed.ticks(3)
    assert refused(armed, ticket) == ["SOCKETS_GONE"]
    place = armed.loop.robot.written.copy()
    report(armed, BACK, 200)
    assert (armed.loop.robot.written == place).all(), "it moved by itself"
    assert armed.events("SOCKETS_GONE")[-1].message.startswith("clients can connect again")
    assert "SOCKETS_GONE" not in armed.loop.publisher.status()
    move(armed)


def test_the_same_report_again_is_one_event(armed: Rig) -> None:
    for _ in range(3):
        report(armed, GONE)
    assert len(armed.events("SOCKETS_GONE")) == 1


def test_a_socket_that_was_bound_again_at_once_costs_no_motion(armed: Rig) -> None:
    move(armed)
    report(armed, link.Reachable(rebound=["control.sock"]))
    assert armed.loop.executor.motion is Motion.ACTIVE
    (event,) = armed.events("SOCKETS_GONE")
    assert (event.level, "bound again" in event.message) == ("warning", True)


def test_a_motion_that_waits_for_its_start_never_begins(armed: Rig) -> None:
    armed.lease()
    armed.submit(armed.path("head_yaw", [0.5], [1.0]), start_in=0.5)
    armed.ticks(3)
    assert armed.loop.executor.waiting == 1
    place = armed.loop.robot.written.copy()
    report(armed, GONE)
    report(armed, BACK, 100)
    assert (armed.loop.robot.written == place).all()


def test_an_arming_under_way_is_given_up(live: Rig) -> None:
    live.connect()
    live.lease()
    ticket = live.send(link.Arm)
    live.ticks(3)
    assert live.loop.condition.state is RobotState.ARMING
    report(live, GONE, 100)
    assert torque_off(live.loop) is True
    assert live.loop.condition.state is RobotState.CONNECTED
    assert live.replies(ticket)[-1].error is not None


def test_arming_is_refused(live: Rig) -> None:
    live.connect()
    report(live, GONE)
    live.lease()
    assert "SOCKETS_GONE" in refused(live, live.call(link.Arm).ticket)


@pytest.mark.parametrize("kind", [link.EStop, link.Disarm])
def test_stops_are_carried_out_as_ever(armed: Rig, kind: type[link.Command]) -> None:
    report(armed, GONE)
    assert armed.call(kind, ticks=900).error is None
    armed.seconds(5.0)
    assert torque_off(armed.loop) is True


def test_a_way_to_the_rest_pose_goes_on(armed: Rig) -> None:
    ticket = armed.send(link.Disarm)
    armed.ticks(20)
    report(armed, GONE, 600)
    assert armed.replies(ticket)[-1].error is None
    assert torque_off(armed.loop) is True


@pytest.mark.parametrize("mode", [Mode.SIM, Mode.MIRROR])
def test_a_loop_without_sockets_holds_in_every_mode(make_rig: MakeRig, mode: Mode) -> None:
    rig = make_rig(mode=mode)
    if mode is Mode.MIRROR:
        rig.connect()
    move(rig)
    report(rig, GONE, 100)
    assert rig.loop.executor.motion is Motion.HOLDING
    rig.lease()
    ask(rig)
    assert "SOCKETS_GONE" in reported_codes(rig)


def test_a_check_only_warns(armed: Rig) -> None:
    report(armed, GONE)
    armed.lease()
    ticket = armed.submit(armed.path("head_yaw", [0.2], [1.0]), check_only=True)
    armed.ticks(3)
    verdict = armed.replies(ticket)[-1].parameters["verdict"]
    assert verdict["refusals"] == []
    assert "SOCKETS_GONE" in [finding["code"] for finding in verdict["warnings"]]
