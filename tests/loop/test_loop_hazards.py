"""Hazards: what must stay true when things happen at the wrong moment."""

import numpy as np
import pytest

from tests.support.daemon_rig import CLIENT, MakeRig, Rig
from twind import link
from twind.loop.procedures.internal_faults import inhibit
from twind.loop.procedures.torque_readback import torque_inherited
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion, RobotState
from twind.safety.guard import FINE
from twind_drivers.bus import PingRequest


def on(rig: Rig) -> np.ndarray:
    return rig.register("torque_enable") == 1


def energise(rig: Rig) -> None:
    for bus in rig.virtual.values():
        for row in range(len(np.asarray(bus.servos["id"]))):
            bus.servos.torque(row, True)


@pytest.mark.parametrize("moment", [2, 5, 20, 60])
@pytest.mark.parametrize("level", ["cut", "settle"])
def test_an_e_stop_switches_off_torque_not_yet_read(make_rig: MakeRig, moment: int, level: str) -> None:
    rig = make_rig()
    energise(rig)
    rig.ticks(moment)
    reply = rig.call(link.EStop, ticks=900, level=level, more=True)
    assert reply.parameters["torque_off"] is True
    assert not on(rig).any()


def test_an_estop_by_settling_lowers_a_robot_that_was_found_energised(make_rig: MakeRig) -> None:
    rig = make_rig(start={"head_yaw": 0.5})
    energise(rig)
    rig.connect()
    ticket = rig.send(link.EStop, more=True)
    rig.ticks(30)
    assert on(rig).all()  # on its way, not dropped
    assert rig.replies(ticket)[0].parameters["done"] is False
    rig.seconds(5.0)
    assert np.abs(rig.truth - rig.loop.robot.rest).max() < 0.05
    assert not on(rig).any()
    assert rig.replies(ticket)[-1].parameters["done"] is True


def test_every_estop_is_answered_even_when_another_overtakes_it(armed: Rig) -> None:
    first = armed.send(link.EStop, client=3, more=True)
    armed.ticks(1)
    second = armed.send(link.EStop, client=4, level="cut")
    third = armed.send(link.EStop, client=5, level="settle", more=True)
    armed.seconds(1.0)
    for ticket in (first, second, third):
        last = armed.replies(ticket)[-1]
        assert last.continues is False
        assert last.parameters["torque_off"] is True


def test_an_estop_is_answered_when_the_port_goes_in_the_middle_of_it(armed: Rig) -> None:
    ticket = armed.send(link.EStop, client=3, more=True)
    armed.ticks(3)
    armed.virtual["main"].faults.unplug()
    armed.ticks(10)
    last = armed.replies(ticket)[-1]
    assert last.continues is False
    assert last.parameters["torque_off"] is not True


def test_an_estop_is_served_before_whatever_else_came_in_the_same_tick(armed: Rig) -> None:
    armed.submit(armed.path("head_yaw", [0.5], [1.0]))
    stop = armed.send(link.EStop, client=9, level="cut")
    armed.ticks(15)
    assert armed.replies(stop)[-1].parameters["torque_off"] is True
    assert armed.loop.executor.motion is Motion.IDLE


def test_a_command_that_fails_internally_costs_no_other_command_its_reply(armed: Rig, monkeypatch) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(armed.loop.commands.submissions, "setpoint", broken)
    bad = armed.send(link.Setpoint, joints=[0], positions=[0.1])
    good = armed.send(link.RenewLease)
    armed.ticks(2)
    assert armed.replies(bad)[-1].error == "Busy"
    assert armed.replies(good)[-1].error is None


def test_a_bus_with_other_servos_than_described_is_never_armed(make_rig: MakeRig) -> None:
    rig = make_rig("h24-split")
    rig.arm()
    rig.virtual["upper"].faults.unplug()
    rig.seconds(6.0)
    for id in range(1, 13):
        rig.virtual["upper"].servos.memory.store(
            id - 1, rig.virtual["upper"].servos.memory.tables[0]["model_number"], 1060
        )
    rig.virtual["upper"].faults.replug()
    rig.seconds(2.0)
    rig.call(link.Disarm, ticks=900)
    rig.call(link.Reset)
    rig.lease()
    reply = rig.call(link.Arm)
    assert reply.error == "Refused"
    assert not on(rig).any()


def test_a_failing_tick_on_the_way_down_does_not_drop_the_robot(armed: Rig, monkeypatch) -> None:
    armed.submit(armed.path("r_shoulder_pitch", [-0.8], [1.0]), more=True)
    armed.seconds(1.5)
    armed.send(link.Disarm)
    armed.ticks(20)
    update = armed.loop.parts.twin.update
    monkeypatch.setattr(armed.loop.parts.twin, "update", lambda *_: 1 / 0)
    armed.ticks(1)
    monkeypatch.setattr(armed.loop.parts.twin, "update", update)
    armed.ticks(5)
    assert on(armed).all()
    armed.seconds(6.0)
    assert not on(armed).any()
    assert np.abs(armed.truth - armed.loop.robot.rest).max() < 0.05


def test_a_goal_that_fails_its_last_check_holds_the_robot_and_keeps_it_fed(armed: Rig, monkeypatch) -> None:
    before = armed.counts
    wild = armed.loop.executor.reference.position.copy()
    wild[armed.names.index("l_knee")] = 2.3  # beyond the hard limit
    armed.loop.executor.begin(wild)
    monkeypatch.setattr(armed.loop.parts.guard, "judge", lambda facts: FINE)  # only the last check is left
    armed.ticks(30)
    assert "WIRE_CLAMP" in armed.loop.condition.latches
    assert armed.loop.condition.state is RobotState.FAULT
    assert not (armed.register("bus_watchdog") == 255).any()
    assert on(armed).all()
    assert np.abs(armed.counts - before).max() <= 2


def test_motion_does_not_outlive_the_lease_under_which_it_was_accepted(armed: Rig) -> None:
    armed.submit(armed.path("head_yaw", [1.0], [4.0]), more=True)
    armed.ticks(50)
    armed.front.outer.send(link.encode(link.ConnectionClosed(client=CLIENT)))
    armed.send(link.AcquireLease, client=CLIENT + 1)
    armed.ticks(60)
    assert armed.loop.parts.lease.held_by(CLIENT + 1, armed.clock.now())
    assert armed.loop.executor.motion is Motion.HOLDING


def test_torque_off_does_not_wait_until_an_inhibited_daemon_has_been_quiet_long_enough(armed: Rig) -> None:
    inhibit(armed.loop, Finding(ReasonCode.INTERNAL, message="a bug"), armed.clock.now())
    armed.ticks(2)
    assert on(armed).all()
    armed.send(link.EStop, level="cut")
    armed.ticks(2)
    assert not on(armed).any()


def test_an_e_stop_before_identification_still_leads_to_connected_after_a_reset(make_rig: MakeRig) -> None:
    rig = make_rig()
    rig.ticks(5)
    rig.call(link.EStop, ticks=900)
    rig.seconds(1.0)
    rig.call(link.Reset)
    rig.seconds(1.0)
    assert rig.loop.condition.state is RobotState.CONNECTED


def test_torque_that_could_not_be_read_back_off_leaves_no_state_without_a_way_out(armed: Rig) -> None:
    armed.virtual["main"].faults.silence(7)
    reply = armed.call(link.Disarm, ticks=900)
    assert reply.error == "BusFailed"
    armed.virtual["main"].faults.silence(7, False)
    armed.seconds(3.0)
    assert not on(armed).any()  # ordered again when it answered
    assert torque_inherited(armed.loop) is False
    assert armed.call(link.Disarm, ticks=900).error is None
    armed.call(link.Reset)
    armed.seconds(1.0)
    assert armed.loop.condition.state is RobotState.CONNECTED


def test_a_second_trajectory_is_refused_at_once_while_one_is_judged_or_waits(armed: Rig) -> None:
    time = np.linspace(0.02, 40.0, 2000)
    path = armed.path("head_yaw", list(0.3 * np.sin(np.pi * time / 40.0) ** 4), list(time))
    armed.submit(path, more=True)
    second = armed.submit(path)
    armed.ticks(1)
    assert [f["code"] for f in armed.replies(second)[-1].parameters["findings"]] == ["BUSY"]
    armed.seconds(0.5)
    armed.submit(armed.path("head_yaw", [0.1], [1.0]), start_in=5.0)
    armed.ticks(2)
    later = armed.submit(armed.path("head_yaw", [0.1], [1.0]), start_in=6.0)
    armed.ticks(2)
    assert [f["code"] for f in armed.replies(later)[-1].parameters["findings"]] == ["BUSY"]


def test_a_failed_script_keeps_no_frames_alive(live: Rig) -> None:
    live.connect()
    port = live.loop.hardware.ports[0]

    def script():
        yield PingRequest(99)
        raise KeyError("nobody")

    task = port.run(script())
    live.ticks(5)
    assert task.done
    assert task.error is not None
    assert task.error.__traceback__ is None


@pytest.mark.parametrize("mode", [Mode.SIM, Mode.MIRROR, Mode.LIVE])
def test_a_diverged_simulation_is_reported_once_and_ends_only_motions_that_need_it(
    make_rig: MakeRig, mode: Mode
) -> None:
    rig = make_rig(mode=mode)
    if mode is Mode.LIVE:
        rig.arm()
    elif mode is Mode.MIRROR:
        rig.connect()
    rig.lease()
    rig.submit(rig.path("head_yaw", [0.4], [1.0]), more=True)
    rig.ticks(30)
    assert rig.loop.executor.motion is Motion.ACTIVE
    before = rig.loop.robot.simulated.position.copy()
    rig.loop.parts.twin.simulation.data.qpos[:] = np.nan
    rig.ticks(1)
    told = [event for event in rig.events("INTERNAL") if "simulation" in event.message]
    assert len(told) == 1
    assert np.abs(rig.loop.robot.simulated.position - before).max() < 0.05
    rig.ticks(30)
    assert (rig.loop.executor.motion is Motion.ACTIVE) == (mode is Mode.LIVE)
    assert len([event for event in rig.events("INTERNAL") if "simulation" in event.message]) == 1


def test_a_path_of_the_former_holder_does_not_go_on_beside_the_first_one_of_the_next(armed: Rig) -> None:
    """End of the lease, the next lease and its first motion, all in one tick."""
    armed.submit(armed.path("l_elbow", [-0.9], [4.0]), more=True)
    armed.ticks(50)
    armed.front.outer.send(link.encode(link.ConnectionClosed(client=CLIENT)))
    armed.send(link.AcquireLease, client=CLIENT + 1)
    armed.submit(armed.path("head_yaw", [0.2], [2.0]), client=CLIENT + 1)
    armed.ticks(40)
    velocity = armed.loop.executor.reference.velocity
    assert velocity[armed.names.index("head_yaw")] > 0.0
    assert velocity[armed.names.index("l_elbow")] == 0.0
