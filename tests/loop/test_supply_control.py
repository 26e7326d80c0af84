"""Supply relay and stop button in the whole daemon under a fake clock; the process is a stand-in."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from tests.support.daemon_rig import Rig
from tests.support.power_stand_in import PowerStandIn
from tests.support.scene_rig import ask, move, reported_codes
from twind import link
from twind.loop.procedures.supply_control import CUT_WITHIN, LOST, STARTS
from twind.loop.procedures.torque_readback import torque_off
from twind.power.power_states import ButtonState, RelayState
from twind.power.supply_sequence import COMES, MORE
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, RobotState

FALL = 1.0


@contextmanager
def powered(power: PowerStandIn, mode: Mode = Mode.LIVE, *, welded: bool = False) -> Iterator[Rig]:
    """A daemon whose relay switches the supply of its virtual servos; `welded`: it is on whatever happens."""
    rig = Rig(power=power, mode=mode)
    buses = list(rig.virtual.values())

    def switch(on: bool) -> None:
        for bus in buses:
            bus.advance(rig.clock.now())
            bus.faults.power(on)

    if power.relay_spec is not None and not welded:
        power.switch = switch
        switch(False)
    try:
        yield rig
    finally:
        rig.close()


def supply_faults(rig: Rig) -> list[str]:
    found = rig.loop.publisher.overview(rig.clock.now()).faults
    return [each.message for each in found if each.code is ReasonCode.SUPPLY_RELAY]


def test_the_relay_closes_after_the_fall_and_the_robot_is_armed() -> None:
    power = PowerStandIn()
    with powered(power) as rig:
        begun = rig.clock.now()
        rig.seconds(FALL)
        assert rig.loop.supply.relay_text == "open"
        rig.seconds(3.0)
        assert rig.loop.supply.relay_text == "closed"
        assert power.closed_at is not None
        assert FALL + MORE <= power.closed_at - begun < FALL + MORE + 0.1
        rig.arm()
        rig.seconds(1.0)
        assert not supply_faults(rig)
        assert rig.loop.supply.button_text == "released"
    assert power.ended


def test_in_sim_nothing_is_started() -> None:
    power = PowerStandIn()
    with powered(power, Mode.SIM) as rig:
        rig.seconds(3.0)
        assert power.pid is None
        assert not supply_faults(rig)


def test_a_supply_that_stays_is_reported_and_bars_arming() -> None:
    with powered(PowerStandIn(), welded=True) as rig:
        rig.connect()
        rig.seconds(2.0)
        (event,) = rig.events("SUPPLY_RELAY")
        assert event.findings[0].value == pytest.approx(12.0, abs=0.5)
        rig.lease()
        refused = rig.call(link.Arm)
        assert refused.error == "Refused"
        assert "SUPPLY_RELAY" in [each["code"] for each in refused.parameters["findings"]]
        assert rig.loop.supply.relay_text == "open"


def test_a_supply_that_does_not_come_is_reported() -> None:
    power = PowerStandIn()
    with powered(power) as rig:
        power.switch = lambda on: None
        rig.seconds(FALL + MORE + COMES - 0.2)
        assert not rig.events("SUPPLY_RELAY")
        rig.seconds(0.5)
        assert len(rig.events("SUPPLY_RELAY")) == 1
        assert supply_faults(rig)


@pytest.mark.parametrize("state", [ButtonState.PRESSED, ButtonState.UNPLUGGED])
def test_the_button_lowers_the_robot_then_opens_the_relay_until_reset(state: ButtonState) -> None:
    power = PowerStandIn("settle")
    with powered(power) as rig:
        rig.arm()
        move(rig)
        power.set_button(state)
        rig.ticks(3)
        assert rig.loop.condition.state is RobotState.ESTOP
        assert power.relay is RelayState.CLOSED, "the way to the rest pose needs the supply"
        for _ in range(600):
            rig.ticks(1)
            if power.relay is RelayState.OPEN:
                break
        assert power.relay is RelayState.OPEN
        released = rig.loop.procedures.rank is None
        assert released
        rig.seconds(0.5)
        assert rig.call(link.Reset).error is None
        rig.ticks(2)
        assert rig.loop.condition.state is RobotState.ESTOP, "a reset with the button pressed"
        power.set_button(ButtonState.RELEASED)
        rig.seconds(3.0)
        assert power.relay is RelayState.OPEN
        assert rig.call(link.Reset).error is None
        rig.seconds(2.0)
        assert power.relay is RelayState.CLOSED
        rig.arm()


def press_and_await_open(rig: Rig, power: PowerStandIn) -> None:
    """Press the button on an armed robot; the relay is open afterwards."""
    power.set_button(ButtonState.PRESSED)
    for _ in range(600):
        rig.ticks(1)
        if power.relay is RelayState.OPEN:
            return
    raise AssertionError("the relay stays closed")


def test_an_adapter_that_loses_its_supply_with_the_relay_closes_no_relay_at_a_pressed_button() -> None:
    power = PowerStandIn("settle")
    with powered(power) as rig:
        rig.arm()
        press_and_await_open(rig, power)
        rig.virtual["main"].faults.unplug()
        rig.seconds(5.0)
        assert power.relay is RelayState.OPEN
        power.set_button(ButtonState.RELEASED)
        rig.seconds(3.0)
        assert power.relay is RelayState.OPEN, "the stop is in force until a reset"
        rig.virtual["main"].faults.replug()
        assert rig.call(link.Reset).error is None
        rig.seconds(4.0)
        assert power.relay is RelayState.CLOSED


@pytest.mark.parametrize("state", [ButtonState.PRESSED, ButtonState.UNPLUGGED, ButtonState.UNKNOWN])
def test_the_relay_does_not_close_before_the_button_is_read_released(state: ButtonState) -> None:
    power = PowerStandIn("settle")
    power.set_button(state)
    with powered(power) as rig:
        for _ in range(round((FALL + MORE + 1.0) / rig.loop.robot.period)):
            rig.ticks(1)
            assert power.relay is RelayState.OPEN
        power.set_button(ButtonState.RELEASED)
        rig.seconds(0.5)
        rig.call(link.Reset)
        rig.seconds(2.0)
        assert power.relay is RelayState.CLOSED


def test_the_button_at_level_cut_opens_the_relay_at_once() -> None:
    power = PowerStandIn("cut")
    with powered(power) as rig:
        rig.arm()
        power.set_button(ButtonState.PRESSED)
        rig.seconds(CUT_WITHIN + 0.02)
        assert power.relay is RelayState.OPEN
        assert torque_off(rig.loop) is not False


def test_a_button_without_a_process_stops_the_robot() -> None:
    power = PowerStandIn(relay=False)
    with powered(power) as rig:
        rig.arm()
        power.works = False
        rig.seconds(LOST - 0.1)
        assert rig.loop.condition.state is RobotState.ARMED
        rig.lease()
        ask(rig)
        assert "HW_DISCONNECTED" in reported_codes(rig)
        rig.seconds(0.3)
        assert rig.loop.condition.state is RobotState.ESTOP


def test_a_button_that_is_never_read_bars_arming_then_counts_as_unplugged() -> None:
    power = PowerStandIn(relay=False)
    power.works = False
    with powered(power) as rig:
        rig.connect()
        rig.lease()
        refused = rig.call(link.Arm)
        assert [each["code"] for each in refused.parameters["findings"]] == ["HW_DISCONNECTED"]
        rig.seconds(STARTS)
        assert rig.loop.condition.state is RobotState.ESTOP


def test_a_loop_that_stood_still_finds_the_relay_open_until_the_robot_is_disarmed() -> None:
    power = PowerStandIn()
    with powered(power) as rig:
        rig.arm()
        for passed in (0.0, 0.3):  # the process looks at the page by itself meanwhile
            rig.clock.time += passed
            power.supervise(rig.clock.now())
        assert power.relay is RelayState.TRIPPED
        rig.seconds(0.1)
        assert "SUPPLY_RELAY" in reported_codes(rig)
        rig.seconds(10.0)
        assert power.relay is RelayState.OPEN, "it closes on a robot that counts as armed"
        rig.call(link.Disarm, ticks=1000)
        rig.seconds(4.0)
        assert power.relay is RelayState.CLOSED
        assert not supply_faults(rig)
        assert rig.call(link.Reset).error is None
        rig.arm()


def test_a_failed_tick_is_no_heartbeat(monkeypatch: pytest.MonkeyPatch) -> None:
    power = PowerStandIn()
    with powered(power) as rig:
        rig.connect()
        beats = power.beats
        monkeypatch.setattr(rig.loop.parts.twin, "update", lambda *_: 1 / 0)
        rig.ticks(1)
        assert power.beats == beats
        monkeypatch.undo()
        rig.ticks(1)
        assert power.beats == beats + 1
