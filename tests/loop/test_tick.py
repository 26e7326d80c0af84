"""The tick: readings, goals, faults, modes, lease; the whole daemon under a fake clock."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.loop import four_buses
from tests.support.daemon_rig import CLIENT, MakeRig, Rig
from twind import link
from twind.robot.modes import Mode, Motion, RobotState


def last(rig: Rig, ticket: int) -> link.Reply:
    return rig.replies(ticket)[-1]


def test_a_trajectory_within_the_limits_is_followed_to_its_end(armed: Rig) -> None:
    ticket = armed.submit(armed.path("l_elbow", [-0.8, -0.2], [1.0, 2.0]), more=True)
    armed.seconds(3.0)
    phases = [reply.parameters["phase"] for reply in armed.replies(ticket)]
    assert phases[0] == "accepted" and phases[-1] == "succeeded" and "running" in phases
    assert armed.truth[armed.names.index("l_elbow")] == pytest.approx(-0.2, abs=0.02)


def test_a_trajectory_beyond_a_limit_is_refused_with_joint_point_value_and_bound(armed: Rig) -> None:
    before = armed.register("goal_position")
    ticket = armed.submit(armed.path("l_knee", [0.5, 3.0], [1.0, 3.0]))
    armed.seconds(1.0)
    finding = next(f for f in last(armed, ticket).parameters["findings"] if f["code"] == "POS_LIMIT")
    assert (finding["joint"], finding["point"]) == (armed.names.index("l_knee"), 1)
    assert finding["value"] == pytest.approx(3.0) and finding["bound"] == pytest.approx(2.2)
    assert np.array_equal(armed.register("goal_position"), before)


def test_motion_holds_when_the_lease_lapses(armed: Rig) -> None:
    armed.submit(armed.path("head_yaw", [1.0], [4.0]))
    armed.seconds(1.5)
    assert armed.loop.executor.motion is Motion.HOLDING
    assert armed.loop.condition.state is RobotState.ARMED
    assert (armed.register("torque_enable") == 1).all()
    assert 0.05 < armed.truth[0] < 0.6


def test_an_open_submission_keeps_the_lease_and_a_closed_connection_drops_it(armed: Rig) -> None:
    armed.submit(armed.path("head_yaw", [1.0], [4.0]), more=True)
    armed.seconds(2.0)
    assert armed.loop.executor.motion is Motion.ACTIVE
    armed.front.outer.send(link.encode(link.ConnectionClosed(client=CLIENT)))
    armed.seconds(0.5)
    assert armed.loop.executor.motion is Motion.HOLDING


def test_cancel_needs_no_lease_and_decelerates_to_a_hold(armed: Rig) -> None:
    ticket = armed.submit(armed.path("head_yaw", [1.0], [2.0]), more=True)
    armed.ticks(50)
    armed.call(link.Cancel, client=99)
    armed.ticks(30)
    assert armed.loop.executor.motion is Motion.HOLDING
    assert last(armed, ticket).parameters["phase"] == "cancelled"


def test_a_servo_silent_for_half_a_second_is_a_fault_and_the_others_hold(armed: Rig) -> None:
    armed.submit(armed.path("head_yaw", [1.0], [4.0]), more=True)
    armed.ticks(20)
    armed.virtual["main"].faults.silence(7)
    armed.ticks(15)
    assert armed.loop.executor.motion is Motion.HOLDING
    assert armed.loop.condition.state is RobotState.ARMED
    armed.seconds(0.5)
    assert armed.loop.condition.state is RobotState.FAULT
    held = armed.truth
    armed.seconds(6.0)
    assert (armed.register("torque_enable") == 1).all()  # it hangs on a gantry
    assert armed.truth == pytest.approx(held, abs=0.002)
    assert armed.loop.condition.state is RobotState.FAULT
    assert armed.call(link.Disarm, ticks=1000).error is not None  # one cannot confirm it
    assert (np.delete(armed.register("torque_enable"), 6) == 0).all()


@pytest.mark.slow
def test_a_servo_silent_for_half_a_second_lowers_what_stands_freely(make_rig: MakeRig) -> None:
    rig = make_rig(support="free")
    rig.arm()
    rig.virtual["main"].faults.silence(7)
    rig.seconds(0.6)
    assert rig.loop.condition.state is RobotState.FAULT
    rig.seconds(14.0)
    assert (np.delete(rig.register("torque_enable"), 6) == 0).all()


def test_a_servo_that_drops_its_torque_is_a_fault(armed: Rig) -> None:
    armed.virtual["main"].servos.torque(3, False)
    armed.seconds(0.3)
    assert armed.loop.condition.state is RobotState.FAULT
    assert "TORQUE_MISMATCH" in armed.loop.condition.latches


def test_mirror_writes_nothing_and_moves_only_the_simulation(make_rig: MakeRig) -> None:
    rig = make_rig(mode=Mode.MIRROR)
    rig.connect()
    rig.lease()
    goals = rig.register("goal_position")
    truth = rig.truth
    ticket = rig.submit(rig.path("head_yaw", [0.4], [1.0]), more=True)
    rig.seconds(2.0)
    assert last(rig, ticket).parameters["phase"] == "succeeded"
    assert rig.loop.robot.simulated.position[0] == pytest.approx(0.4, abs=0.05)
    assert np.array_equal(rig.register("goal_position"), goals)
    assert np.array_equal(rig.truth, truth)


def test_sim_opens_no_bus_and_still_judges(make_rig: MakeRig) -> None:
    rig = make_rig(mode=Mode.SIM)
    rig.ticks(10)
    assert all(port.reader is None for port in rig.loop.hardware.ports)
    rig.lease()
    rig.loop.robot.measured = rig.loop.robot.simulated
    good = rig.submit(rig.path("head_yaw", [0.4], [1.0]), more=True)
    rig.seconds(1.8)
    assert last(rig, good).parameters["phase"] == "succeeded"
    bad = rig.submit(rig.path("l_knee", [9.0], [5.0]))
    rig.ticks(3)
    assert last(rig, bad).error == "Refused"


def test_estop_in_sim_latches_and_answers_at_once(make_rig: MakeRig) -> None:
    rig = make_rig(mode=Mode.SIM)
    rig.ticks(2)
    rig.lease()
    reply = rig.call(link.EStop, ticks=3)
    assert reply.parameters == {"state": "estop", "torque_off": None, "done": True}
    rig.loop.robot.measured = rig.loop.robot.simulated
    refused = rig.submit(rig.path("head_yaw", [0.4], [1.0]))
    rig.ticks(3)
    assert "ESTOP_LATCHED" in [f["code"] for f in last(rig, refused).parameters["findings"]]
    assert rig.call(link.Reset).parameters["state"] == "disconnected"
    again = rig.submit(rig.path("head_yaw", [0.4], [1.0]), more=True)
    rig.lease()
    rig.seconds(2.0)
    assert last(rig, again).parameters["phase"] == "succeeded"


def test_after_e_stop_and_reset_in_sim_the_simulation_moves_only_on_a_new_command(make_rig: MakeRig) -> None:
    rig = make_rig(mode=Mode.SIM)
    rig.ticks(2)
    rig.lease()
    rig.submit(rig.path("head_yaw", [0.8], [1.0]))
    rig.seconds(0.6)
    rig.call(link.EStop, ticks=3)
    rig.seconds(1.0)
    stopped = rig.loop.robot.simulated.position.copy()
    assert 0.1 < stopped[rig.names.index("head_yaw")] < 0.8
    rig.call(link.Reset)
    rig.seconds(1.0)
    assert np.abs(rig.loop.robot.simulated.position - stopped).max() < 0.01
    rig.lease()
    rig.submit(rig.path("head_yaw", [0.4], [1.5]))
    rig.seconds(2.0)
    assert abs(rig.loop.robot.simulated.position[rig.names.index("head_yaw")] - 0.4) < 0.05


def test_modes_change_only_while_disarmed(armed: Rig) -> None:
    assert armed.call(link.SetMode, mode="mirror").error == "Refused"
    armed.call(link.Disarm, ticks=800)
    assert armed.call(link.SetMode, mode="mirror").parameters == {"mode": "mirror"}
    assert armed.loop.hardware.writers == []
    assert armed.call(link.SetMode, mode="live").parameters == {"mode": "live"}
    armed.lease()
    assert armed.call(link.Arm).error is None


def test_a_long_trajectory_is_judged_in_slices_and_then_accepted(armed: Rig) -> None:
    time = np.linspace(0.02, 40.0, 2000)
    path = armed.path("head_yaw", list(0.3 * np.sin(np.pi * time / 40.0) ** 4), list(time))
    ticket = armed.submit(path, more=True)
    armed.ticks(1)
    assert not armed.replies(ticket)
    armed.ticks(20)
    assert armed.replies(ticket)[0].parameters["phase"] == "accepted"


def test_setpoints_stream_and_a_silent_stream_comes_to_a_hold(armed: Rig) -> None:
    for step in range(40):
        reply = armed.send(link.Setpoint, joints=[0], positions=[0.01 * step])
        armed.ticks(1)
        assert last(armed, reply).error is None
    assert armed.loop.executor.motion is Motion.STREAMING
    armed.seconds(0.6)
    assert armed.loop.executor.motion is Motion.HOLDING
    assert armed.truth[0] == pytest.approx(0.39, abs=0.06)


def test_a_bus_without_replies_counts_as_disconnected_and_is_identified_again(live: Rig) -> None:
    live.connect()
    for id in range(1, 25):
        live.virtual["main"].faults.silence(id)
    live.seconds(1.5)
    assert live.loop.hardware.connected
    live.seconds(1.5)
    assert not live.loop.hardware.connected
    assert live.loop.condition.state is RobotState.IDENTIFYING
    for id in range(1, 25):
        live.virtual["main"].faults.silence(id, False)
    live.seconds(3.0)
    assert live.loop.condition.state is RobotState.CONNECTED
    assert not live.loop.identity.troubles


@pytest.mark.parametrize(
    "motions", [pytest.param(2, marks=pytest.mark.slow), pytest.param(9, marks=pytest.mark.campaign)]
)
def test_motions_in_a_row_without_a_refusal_a_fault_or_a_missed_reading(
    make_rig: MakeRig, motions: int
) -> None:
    """Each takes 8 s; `make faults HOURS=1` makes it an hour."""
    rig = make_rig()
    rig.arm()
    path = rig.path("head_yaw", [0.5, -0.5, 0.0], [2.0, 5.0, 7.0])
    for _ in range(motions):
        rig.news.clear()
        rig.lease()
        ticket = rig.submit(path, more=True)
        rig.seconds(8.0)
        assert last(rig, ticket).parameters["phase"] == "succeeded"
    assert rig.loop.condition.state is RobotState.ARMED
    assert rig.loop.hardware.ports[0].counts.errors == 0
    assert rig.loop.figures.missed == 0


def test_at_500_hz_every_slow_register_is_still_read_in_time(make_rig: MakeRig, tmp_path: Path) -> None:
    """The end of a tick keeps a share of it free: 1.5 ms of 2 would leave the upkeep no room."""
    rig = make_rig(str(four_buses(tmp_path / "h24-four.yaml")), rate_hz=500.0)
    rig.connect()
    rig.seconds(0.5)
    slow = rig.loop.hardware.slow
    now = rig.clock.now()
    assert (now - slow.status_time <= 0.1).all()
    assert (now - slow.health_time <= 0.4).all()


def test_at_500_hz_at_most_one_bus_of_five_ticks_is_asked_beside_its_cyclic_reading(
    make_rig: MakeRig, tmp_path: Path
) -> None:
    """100 turns a second do for every bus; more would only cost, all of them in the same tick most of all."""
    rig = make_rig(str(four_buses(tmp_path / "h24-four.yaml")), rate_hz=500.0)
    rig.connect()
    rig.seconds(0.1)
    asked: list[str] = []
    for port in rig.loop.hardware.ports:
        reader = port.reader
        assert reader is not None

        def counted(*query: Any, name: str = port.name, begin: Any = reader.begin) -> None:
            asked.append(name)
            begin(*query)

        reader.begin = counted  # type: ignore[method-assign]
    most = 0
    for _ in range(50):
        before = len(asked)
        rig.ticks(1)
        most = max(most, len(asked) - before)
    assert most == 1
    assert [asked.count(name) for name in "abcd"] == [10] * 4
