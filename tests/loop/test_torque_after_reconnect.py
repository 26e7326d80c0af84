"""Torque that is ours stays ours: lost buses, deaf servos, late orders, and who may not interfere."""

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.loop.procedures.torque_readback import torque_off
from twind.robot.modes import RobotState


def on(rig: Rig) -> np.ndarray:
    return rig.register("torque_enable") == 1


def energise(rig: Rig) -> None:
    for bus in rig.virtual.values():
        for row in range(len(np.asarray(bus.servos["id"]))):
            bus.servos.torque(row, True)


def test_a_reboot_that_waits_does_not_land_on_a_robot_that_is_armed(live: Rig) -> None:
    live.connect()
    live.lease()
    for id in range(1, 5):
        live.send(link.Reboot, client=9, bus="main", id=id)
    live.call(link.Arm)
    live.seconds(1.0)
    assert on(live).all() or not on(live).any()
    assert live.loop.condition.state in (RobotState.ARMED, RobotState.CONNECTED, RobotState.IDENTIFYING)


@pytest.mark.parametrize("kind", [link.Disarm, link.EStop])
def test_taking_the_lease_never_cuts_the_way_to_the_rest_pose(armed: Rig, kind: type[link.Command]) -> None:
    armed.submit(armed.path("r_shoulder_pitch", [-0.8], [1.0]), more=True)
    armed.seconds(1.5)
    armed.send(kind)
    for client in (20, 21, 22):
        armed.ticks(20)
        armed.send(link.AcquireLease, client=client, take=True)
    while on(armed).any():
        lowest = armed.truth
        armed.ticks(1)
    assert np.abs(lowest - armed.loop.robot.rest).max() < 0.05


def test_a_robot_found_energised_is_lowered_though_one_servo_never_answered(make_rig: MakeRig) -> None:
    rig = make_rig(start={"head_yaw": 0.5})
    energise(rig)
    rig.virtual["main"].faults.silence(9)
    rig.seconds(2.0)
    rig.send(link.EStop)
    rig.ticks(60)
    assert np.delete(on(rig), 8).all()  # on its way, not dropped
    rig.seconds(6.0)
    assert abs(rig.truth[0] - rig.loop.robot.rest[0]) < 0.05
    assert not np.delete(on(rig), 8).any()
    assert "INTERNAL" not in rig.loop.condition.latches


def test_torque_is_not_reported_off_while_an_armed_bus_is_absent(make_rig: MakeRig) -> None:
    rig = make_rig("h24-split")
    rig.arm()
    rig.virtual["upper"].faults.unplug()
    reply = rig.call(link.EStop, level="cut", ticks=400)
    assert reply.parameters["torque_off"] is not True
    assert reply.parameters["done"] is False


def test_a_disarm_names_the_bus_that_does_not_answer(armed: Rig) -> None:
    armed.virtual["main"].faults.unplug()
    armed.ticks(5)
    reply = armed.call(link.Disarm)
    assert reply.error == "BusFailed"
    assert reply.parameters["bus"] == "main"


def test_an_estop_while_the_bus_is_away_is_carried_out_when_it_comes_back(armed: Rig) -> None:
    armed.virtual["main"].faults.unplug()
    armed.ticks(5)
    armed.call(link.EStop, level="cut")
    assert on(armed).all()
    armed.virtual["main"].faults.replug()
    armed.seconds(3.0)
    assert not on(armed).any()
    assert torque_off(armed.loop) is True


@pytest.mark.parametrize("mode", ["mirror", "sim"])
@pytest.mark.parametrize("reset", [True, False])
def test_mode_live_is_not_left_while_torque_of_a_lost_bus_is_not_read_off(
    armed: Rig, mode: str, reset: bool
) -> None:
    """In another mode nothing switches it off, and in mode sim nothing even reads it."""
    armed.virtual["main"].faults.unplug()
    armed.ticks(20)
    if reset:
        assert armed.call(link.Reset).error is None
    [finding] = armed.call(link.SetMode, mode=mode).parameters["findings"]
    assert finding["code"] == "MODE_DENIES" and "was lost" in finding["message"]
    armed.virtual["main"].faults.replug()
    armed.seconds(2.0)
    assert on(armed).all()
    assert armed.call(link.SetMode, mode=mode).error == "Refused"
    assert armed.call(link.Disarm, ticks=1000).error is None
    if not reset:
        assert armed.call(link.Reset).error is None
    assert armed.call(link.SetMode, mode=mode).error is None


def test_a_lost_bus_whose_servos_come_back_without_torque_does_not_hold_the_mode(armed: Rig) -> None:
    bus = armed.virtual["main"]
    bus.faults.unplug()
    armed.ticks(20)
    for id in bus.servos["id"]:
        bus.faults.brown_out(int(id))
    bus.faults.replug()
    armed.seconds(2.0)
    assert armed.call(link.Reset).error is None
    assert armed.call(link.SetMode, mode="sim").error is None


def test_sigterm_waits_for_a_bus_that_went_away_with_our_torque(armed: Rig) -> None:
    armed.virtual["main"].faults.unplug()
    armed.ticks(10)
    armed.loop.condition.stop_wanted = True
    armed.ticks(5)
    armed.virtual["main"].faults.replug()
    for _ in range(1500):
        if armed.loop.condition.finished:
            break
        armed.ticks(1)
    assert armed.loop.condition.finished
    assert not on(armed).any()


@pytest.mark.parametrize("moment", range(1, 16))
def test_a_bug_while_arming_what_was_found_energised_ends_unarmed_and_answered(
    make_rig: MakeRig, moment: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig()
    energise(rig)
    rig.connect()
    rig.lease()
    ticket = rig.send(link.Arm)
    rig.ticks(moment)
    update = rig.loop.parts.twin.update
    monkeypatch.setattr(rig.loop.parts.twin, "update", lambda *_: 1 / 0)
    rig.ticks(1)
    monkeypatch.setattr(rig.loop.parts.twin, "update", update)
    rig.seconds(1.0)
    assert len([reply for reply in rig.replies(ticket) if not reply.continues]) == 1
    if rig.replies(ticket)[-1].error is not None:
        assert rig.loop.torque.armed is False
        assert on(rig).all()  # what was found on keeps its torque


def test_stops_that_keep_coming_do_not_put_off_the_end_of_the_daemon(live: Rig) -> None:
    live.connect()
    live.loop.condition.stop_wanted = True
    for _ in range(200):
        if live.loop.condition.finished:
            break
        live.send(link.EStop, level="cut")
        live.ticks(1)
    assert live.loop.condition.finished


def test_a_bus_that_comes_back_while_the_others_are_taken_over_gets_no_goals(make_rig: MakeRig) -> None:
    """Its tripped servos would refuse them, and the robot would be damped for what they do not follow."""
    rig = make_rig("h24-split", start={"head_yaw": 0.5})
    energise(rig)
    rig.seconds(2.0)
    rig.send(link.EStop)
    while rig.loop.procedures.rank is None:
        rig.ticks(1)
    rig.ticks(1)
    lower = rig.virtual["lower"]
    lower.faults.unplug()
    rig.virtual["upper"].faults.silence(12)  # the take-over waits for its replies
    rig.ticks(1)
    lower.faults.replug()
    while not rig.loop.torque.armed:
        rig.ticks(1)
    there = [port.reader is not None for port in rig.loop.hardware.ports]
    assert (there, rig.loop.torque.held.tolist()) == ([True, True], [True] * 12 + [False] * 12)
    rig.seconds(8.0)
    assert not rig.events("DAMP")
    assert abs(rig.truth[0] - rig.loop.robot.rest[0]) < 0.05
    assert not np.delete(on(rig), 11).any()
