"""`calibrating`: begun by who holds the lease, ended with it; EEPROM is written then and at no other time."""

from collections.abc import Callable
from typing import Any

import pytest

from tests.support.daemon_rig import CLIENT, MakeRig, Rig
from tests.support.eeprom_access import calibrate, calibrated
from twind import link
from twind.loop.procedures.procedure_runner import Priority, Procedure
from twind.loop.procedures.torque_readback import torque_possible
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, RobotState

OTHER = 9  # another client


def off(rig: Rig) -> link.Reply:
    return rig.call(link.Calibrate, on=False)


def codes(reply: link.Reply) -> set[str]:
    assert reply.error == "Refused", reply
    return {finding["code"] for finding in reply.parameters["findings"]}


@pytest.fixture(params=[Mode.MIRROR, Mode.LIVE])
def either(make_rig: MakeRig, request: pytest.FixtureRequest) -> Rig:
    rig: Rig = make_rig(mode=request.param)
    rig.connect()
    return rig


@pytest.fixture
def connected(live: Rig) -> Rig:
    live.connect()
    return live


# --------------------------------------------------------------------------------- begun and ended


def test_calibrating_begins_in_mirror_and_live_shows_in_the_status_and_ends(either: Rig) -> None:
    calibrate(either)
    assert [news for news in either.news if isinstance(news, link.Tick)][-1].state == "calibrating"
    assert off(either).parameters == {"state": "connected"}
    assert either.loop.condition.state is RobotState.CONNECTED


def test_a_repeated_calibrate_call_is_no_error(connected: Rig) -> None:
    calibrate(connected)
    calibrate(connected)
    assert off(connected).parameters == off(connected).parameters == {"state": "connected"}


def test_without_the_lease_it_is_refused(connected: Rig) -> None:
    assert codes(connected.call(link.Calibrate, on=True)) == {"LEASE_MISSING"}
    calibrate(connected)
    assert codes(connected.call(link.Calibrate, client=OTHER, on=False)) == {"LEASE_MISSING"}
    assert connected.loop.condition.state is RobotState.CALIBRATING


def test_in_sim_and_while_armed_it_is_refused_with_what_it_needs(make_rig: MakeRig, armed: Rig) -> None:
    armed.lease()
    reply = armed.call(link.Calibrate, on=True)
    assert (reply.error, reply.parameters) == (
        "WrongState",
        {"state": "armed", "allowed": ["connected", "identifying"]},
    )
    sim = make_rig(mode=Mode.SIM)
    sim.lease()
    reply = sim.call(link.Calibrate, on=True)
    assert (reply.error, reply.parameters["allowed"]) == ("WrongState", ["mode mirror", "mode live"])


def test_while_torque_was_found_on_it_is_refused(live: Rig) -> None:
    live.virtual["main"].servos["torque_enable"][3] = 1
    live.seconds(2.0)
    live.lease()
    reply = live.call(link.Calibrate, on=True)
    assert (reply.error, reply.parameters["allowed"]) == ("WrongState", ["disarmed"])


def test_while_a_fault_is_latched_it_is_refused(connected: Rig) -> None:
    connected.call(link.EStop)
    connected.seconds(1.0)
    connected.lease()
    reply = connected.call(link.Calibrate, on=True)
    assert reply.error == "WrongState"
    assert connected.loop.condition.state is RobotState.ESTOP


def test_calibrate_is_busy_during_an_arming_procedure(connected: Rig) -> None:
    calibrate(connected)

    def forever() -> Procedure:
        while True:
            yield

    assert connected.loop.procedures.own(Priority.ARM, forever)
    assert off(connected).error == "Busy"
    connected.seconds(3.0)  # the lease has lapsed: still whoever has torque ends first
    assert connected.loop.condition.state is RobotState.CALIBRATING
    connected.loop.procedures.abandon()
    connected.ticks(2)
    assert connected.loop.condition.state is RobotState.CONNECTED


# --------------------------------------------------------------------------------- what it keeps from


def test_calibrating_prevents_arming_and_a_mode_change(connected: Rig) -> None:
    calibrate(connected)
    assert "ARM_FAILED" in codes(connected.call(link.Arm))
    assert (connected.register("torque_enable") == 0).all()
    for mode in ("mirror", "sim"):
        connected.lease()
        reply = connected.call(link.SetMode, mode=mode)
        assert codes(reply) == {"MODE_DENIES"}
        assert "end the calibration first" in reply.parameters["findings"][0]["message"]
    calibrated(connected)
    connected.lease()
    assert connected.call(link.Arm).error is None


# --------------------------------------------------------------------------------- ended by itself


def lapsed(rig: Rig) -> None:
    rig.seconds(1.2)


def hung_up(rig: Rig) -> None:
    rig.front.outer.send(link.encode(link.ConnectionClosed(client=CLIENT)))


def front_lost(rig: Rig) -> None:
    rig.loop.parts.link.lost = True


def taken(rig: Rig) -> None:
    assert rig.call(link.AcquireLease, client=OTHER, take=True).error is None


def released(rig: Rig) -> None:
    assert rig.call(link.ReleaseLease).error is None


@pytest.mark.parametrize("lose", [lapsed, hung_up, front_lost, taken, released])
def test_calibrating_ends_with_the_lease_it_began_under(connected: Rig, lose: Callable[[Rig], None]) -> None:
    calibrate(connected)
    lose(connected)
    connected.ticks(3)
    assert connected.loop.condition.state is RobotState.CONNECTED
    assert connected.events(ReasonCode.LEASE_LOST)


def test_calibrating_lasts_as_long_as_the_lease_is_renewed(connected: Rig) -> None:
    calibrate(connected)
    for _ in range(8):
        connected.seconds(0.6)
        assert connected.call(link.RenewLease).error is None
    assert connected.loop.condition.state is RobotState.CALIBRATING


@pytest.mark.parametrize("bus", ["left", "right", None])
def test_calibrating_ends_when_a_port_is_lost(make_rig: MakeRig, bus: str | None) -> None:
    rig = make_rig("h24-split")
    rig.connect()
    names = [each.name for each in rig.robot.buses]
    calibrate(rig)
    for name in names if bus is None else [names[bus == "right"]]:
        rig.virtual[name].faults.unplug()
    rig.ticks(5)
    assert rig.loop.condition.state in (RobotState.DISCONNECTED, RobotState.IDENTIFYING)


def test_an_e_stop_ends_it_and_latches(connected: Rig) -> None:
    calibrate(connected)
    connected.call(link.EStop)
    connected.ticks(3)
    assert connected.loop.condition.state is RobotState.ESTOP


# --------------------------------------------------------------------------------- EEPROM


def write(rig: Rig, name: str, value: int, *, client: int = CLIENT) -> link.Reply:
    return rig.call(link.WriteRegister, client=client, bus="main", id=7, name=name, value=value)


def held(rig: Rig, name: str) -> int:
    reply = rig.call(link.ReadRegister, bus="main", id=7, name=name)
    value: int = reply.parameters["register"]["value"]
    return value


@pytest.mark.parametrize("name", ["homing_offset", "20", "Homing Offset"])
def test_eeprom_is_written_while_calibrating_alone_however_it_is_named(connected: Rig, name: str) -> None:
    reply = write(connected, name, 100)
    assert reply.error == "WrongState"
    assert reply.parameters == {
        "state": f"connected, and {name} of id 7 is EEPROM",
        "allowed": ["calibrating"],
    }
    assert held(connected, "homing_offset") == 0
    calibrate(connected)
    assert write(connected, name, 100).error is None
    assert held(connected, "homing_offset") == 100


def test_a_ram_register_is_written_without_calibrating(connected: Rig) -> None:
    assert write(connected, "position_p_gain", 640).error is None
    assert held(connected, "position_p_gain") == 640


def test_while_another_calibrates_only_ram_is_written(connected: Rig) -> None:
    calibrate(connected)
    assert codes(write(connected, "homing_offset", 100, client=OTHER)) == {"LEASE_MISSING"}
    assert write(connected, "led", 1, client=OTHER).error is None
    assert held(connected, "homing_offset") == 0


def test_a_write_keeps_the_lease(connected: Rig) -> None:
    calibrate(connected)
    for value in range(1, 6):
        connected.seconds(0.6)
        assert write(connected, "homing_offset", value).error is None
    assert connected.loop.condition.state is RobotState.CALIBRATING


def test_every_device_is_identified_after_calibrating(connected: Rig) -> None:
    calibrate(connected)
    assert write(connected, "homing_offset", 0).error is None
    calibrated(connected)
    connected.connect()


def test_a_register_that_no_longer_matches_is_reported_after_calibrating(connected: Rig) -> None:
    calibrate(connected)
    assert write(connected, "homing_offset", 300).error is None
    calibrated(connected)
    connected.connect()
    connected.lease()
    assert "CALIB_MISMATCH" in codes(connected.call(link.Arm))


def test_a_write_that_waits_is_not_made_when_it_is_over(live: Rig) -> None:
    """Torque of one servo is not known, so that of the one that is written is read first."""
    live.virtual["main"].servos["status_return_level"][1] = 0  # answers pings only
    live.seconds(2.0)
    assert torque_possible(live.loop)
    calibrate(live)
    ticket = live.send(link.WriteRegister, bus="main", id=7, name="homing_offset", value=100)
    live.send(link.Calibrate, on=False)
    live.ticks(40)
    (reply,) = live.replies(ticket)
    assert (reply.error, reply.parameters["allowed"]) == ("WrongState", ["calibrating"])
    assert held(live, "homing_offset") == 0


def test_time_that_goes_on_within_a_tick_does_not_end_it(
    connected: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lease that is renewed later than the tick's own time would look like one of the future."""
    calibrate(connected)
    commands = connected.loop.commands
    begin = commands.begin

    def later(*arguments: Any) -> None:
        connected.clock.time += 1e-4  # as on a real machine
        begin(*arguments)

    monkeypatch.setattr(commands, "begin", later)
    for value in range(1, 6):
        assert write(connected, "homing_offset", value).error is None
        assert connected.loop.condition.state is RobotState.CALIBRATING
