"""A bus that went and comes back: how soon that is seen, who is asked again, and nothing of before is left.

Fault matrix rows 1-4, 11, 12 (docs/safety.md) and its times: an unplugged port is seen within 50 ms, and a
port that is back is identified and disarmed within 1 s.
"""

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.loop.procedures.internal_faults import inhibit
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import RobotState
from twind_drivers.bus import BusReader, BusSample


def upper_goals(rig: Rig) -> list[int]:
    return [int(goal) for goal in rig.virtual["upper"].servos["goal_position"]]


def until_connected(rig: Rig, seconds: float = 3.0) -> float:
    """Seconds until every bus is identified."""
    begun = rig.clock.now()
    while not rig.loop.hardware.connected:
        assert rig.clock.now() - begun < seconds
        rig.ticks(1)
    return rig.clock.now() - begun


@pytest.fixture
def moving(make_rig: MakeRig) -> Rig:
    """Armed on two buses, a joint of the first on its way."""
    rig: Rig = make_rig("h24-split")
    rig.arm()
    rig.submit(rig.path("head_yaw", [0.6], [3.0]), more=True)
    rig.ticks(50)
    return rig


@pytest.mark.parametrize("away", [0.05, 0.3, 0.72, 1.3, 4.0])
def test_an_unplugged_bus_is_seen_within_50_ms_and_identified_a_second_after_it_is_back(
    moving: Rig, away: float
) -> None:
    upper = moving.virtual["upper"]
    begun = moving.clock.now()
    upper.faults.unplug()
    while not moving.events("PORT_LOST"):
        moving.ticks(1)
    assert moving.clock.now() - begun <= 0.050
    assert moving.loop.condition.state is RobotState.FAULT
    moving.seconds(away)
    upper.faults.replug()
    assert until_connected(moving) <= 1.0
    assert moving.loop.condition.state is RobotState.FAULT


def test_no_goal_of_before_reaches_a_bus_that_is_back_and_the_other_bus_holds(moving: Rig) -> None:
    upper = moving.virtual["upper"]
    lower = moving.virtual["lower"]
    upper.faults.unplug()
    moving.ticks(5)
    goals = upper_goals(moving)
    legs = moving.counts[12:]
    moving.ticks(10)
    assert lower.servos["torque_enable"].all()
    assert np.abs(moving.counts[12:] - legs).max() <= 2
    upper.faults.replug()
    until_connected(moving)
    moving.seconds(6.0)  # the other bus holds on
    assert upper_goals(moving) == goals
    assert all(lower.servos["torque_enable"])
    assert np.abs(moving.counts[12:] - legs).max() <= 2


def test_on_the_ports_of_another_robot_nothing_is_armed_and_what_differs_is_named(moving: Rig) -> None:
    """Row 4, the wrong adapter: one servo is another model, one is absent."""
    upper = moving.virtual["upper"]
    upper.faults.unplug()
    moving.seconds(6.0)
    memory = upper.servos.memory
    memory.store(2, memory.tables[2]["model_number"], 1060)
    upper.faults.silence(7)
    upper.faults.replug()
    moving.seconds(2.0)
    said = " ".join(finding.message for finding in moving.loop.identity.troubles)
    assert "id 3 on bus upper: is XL430-W250 (model number 1060), the robot file says XM430-W350" in said
    assert "nothing answers as id 7 on bus upper" in said
    assert not moving.loop.hardware.connected
    assert moving.call(link.Arm).error is not None
    assert all(moving.virtual["lower"].servos["torque_enable"])  # it holds, and nobody was armed


@pytest.mark.parametrize("level", ["settle", "cut"])
@pytest.mark.parametrize("robot", ["koch", "h24-split"])
@pytest.mark.parametrize("reset", [True, False])
def test_an_e_stop_while_a_bus_is_away_switches_torque_off_when_it_is_back(
    make_rig: MakeRig, robot: str, level: str, reset: bool
) -> None:
    """Also where it was reset before, and no other bus was left that it could stop."""
    rig: Rig = make_rig(robot)
    rig.arm()
    bus = rig.virtual["upper" if robot == "h24-split" else "main"]
    bus.faults.unplug()
    rig.ticks(20)
    rig.call(link.EStop, level=level)
    rig.seconds(6.0)
    assert bus.servos["torque_enable"].all()
    if reset:
        assert rig.call(link.Reset).error is None
    bus.faults.replug()
    rig.seconds(12.0)
    assert not bus.servos["torque_enable"].any()
    assert rig.call(link.Reset).error is None
    assert rig.loop.condition.state is RobotState.CONNECTED


# ------------------------------------------------------------------------------------- power


def power_off(rig: Rig, bus: str) -> None:
    """The servos of a bus lose their supply; the adapter, powered by USB, stays."""
    for id in rig.virtual[bus].servos["id"]:
        rig.virtual[bus].faults.silence(int(id))


def power_on(rig: Rig, bus: str) -> None:
    """They boot: torque off, RAM as at delivery."""
    for id in rig.virtual[bus].servos["id"]:
        rig.virtual[bus].faults.brown_out(int(id))
    rig.virtual[bus].faults.clear()


@pytest.mark.parametrize("ticks", [230, 260, 290])
def test_a_chain_that_gets_its_power_after_the_daemon_is_identified_at_once(
    make_rig: MakeRig, ticks: int
) -> None:
    """Not at the next of the tries of every second."""
    rig = make_rig()
    power_off(rig, "main")
    rig.ticks(ticks)
    assert rig.loop.condition.state is RobotState.IDENTIFYING
    power_on(rig, "main")
    rig.virtual["main"].faults.silence(on=False)
    late = 0
    while rig.loop.condition.state is not RobotState.CONNECTED:
        rig.ticks(1)
        late += bool(rig.loop.robot.measured.heard.any())
        assert late < 25


@pytest.mark.parametrize("seconds", [0.15, 0.6, 1.5, 2.5, 4.2, 6.0])
def test_a_short_power_loss_is_detected_and_every_device_identified_within_a_second(
    moving: Rig, seconds: float
) -> None:
    (port,) = [port for port in moving.loop.hardware.ports if port.name == "upper"]
    power_off(moving, "upper")
    moving.seconds(seconds)
    power_on(moving, "upper")
    begun = moving.clock.now()
    first = port.identification
    while not moving.events("HW_DISCONNECTED") or port.identification is first:
        moving.ticks(1)
        assert moving.clock.now() - begun < 1.0
    until_connected(moving)
    assert moving.clock.now() - begun < 1.5
    assert moving.loop.condition.state is RobotState.FAULT
    limp = moving.counts[:12]
    moving.seconds(1.0)
    assert not any(moving.virtual["upper"].servos["torque_enable"])
    assert np.abs(moving.counts[:12] - limp).max() <= 2


def test_a_robot_that_is_not_armed_is_asked_anew_after_a_blip_and_can_be_armed_again(
    make_rig: MakeRig,
) -> None:
    rig = make_rig("h24-split")
    rig.connect()
    power_off(rig, "upper")
    rig.seconds(0.5)
    power_on(rig, "upper")
    rig.seconds(1.5)  # servos begin anew, everybody is asked, and a second of the bus is good
    assert rig.events("HW_DISCONNECTED")
    assert rig.loop.condition.state is RobotState.CONNECTED
    rig.lease()
    assert rig.call(link.Arm).error is None


def test_a_single_servo_without_replies_is_not_a_power_loss(make_rig: MakeRig) -> None:
    rig = make_rig("h24-split")
    rig.connect()
    rig.virtual["upper"].faults.silence(3)
    rig.seconds(0.5)
    rig.virtual["upper"].faults.clear()
    rig.seconds(0.5)
    assert not rig.events("HW_DISCONNECTED")


def test_a_deliberately_inhibited_loop_reports_no_lost_device(armed: Rig) -> None:
    inhibit(armed.loop, Finding(ReasonCode.INTERNAL), armed.clock.now())
    armed.seconds(1.0)
    assert not armed.events("HW_DISCONNECTED")
    assert armed.loop.hardware.connected


# ------------------------------------------------------------------------------------- the port itself


def test_a_port_warning_is_reported_once_with_its_remedy(make_rig: MakeRig) -> None:
    rig = make_rig()
    opened = rig.open_port

    def slow(name: str) -> BusReader:
        reader = opened(name)
        reader.transport.warning = "the adapter's latency timer is 16 ms"
        return reader

    rig.loop.hardware.ports[0].opener = slow
    rig.connect()
    rig.seconds(1.0)
    (event,) = rig.events("PORT_WARNING")
    assert (event.level, event.message) == ("warning", "main: the adapter's latency timer is 16 ms")
    overview = rig.loop.publisher.overview(rig.clock.now())
    assert [bus.warning for bus in overview.buses] == ["the adapter's latency timer is 16 ms"]


# ------------------------------------------------------------------------------------- two with one id


def test_an_id_with_only_corrupt_replies_is_missing_with_the_likely_cause(make_rig: MakeRig) -> None:
    rig = make_rig()
    rig.virtual["main"].faults.corrupt(1_000_000, id=5)
    rig.seconds(1.0)
    (finding,) = rig.loop.identity.troubles
    assert finding.message.startswith("nothing answers as id 5 on bus main; but bytes arrive")
    assert "two devices with this id? Stop the daemon: `twindctl scan --port PORT` shows" in finding.message
    assert not rig.loop.hardware.connected


def mute_readings(rig: Rig, place: int, count: int) -> None:
    """Spoil the device at `place` in the first `count` cyclic readings, as two servos with one id do."""
    opened = rig.open_port

    def opener(name: str) -> BusReader:
        reader = opened(name)
        left = [count]
        finish = reader.finish

        def finished(now: float) -> BusSample:
            sample = finish(now)
            left[0] -= 1
            if left[0] >= 0:
                sample.heard[place] = False
            return sample

        reader.finish = finished  # type: ignore[method-assign]
        return reader

    rig.loop.hardware.ports[0].opener = opener


def test_an_identified_device_without_a_valid_reading_is_not_connected(make_rig: MakeRig) -> None:
    """Row 12 of the fault matrix: two of one model say the same, and are in two places."""
    rig = make_rig()
    mute_readings(rig, 4, 150)
    rig.seconds(1.0)
    (finding,) = rig.loop.identity.troubles
    assert finding.message.startswith("id 5 on bus main answers, but not one of its readings is sound")
    assert not rig.loop.hardware.connected
    rig.seconds(2.0)  # one of the two was taken away
    assert rig.loop.hardware.connected
    assert rig.loop.identity.troubles == []


def test_a_reading_that_is_lost_at_the_start_makes_no_duplicate(make_rig: MakeRig) -> None:
    rig = make_rig()
    mute_readings(rig, 4, 3)
    rig.seconds(0.5)
    assert rig.loop.hardware.connected
    assert not rig.events("DEVICE_MISSING")
