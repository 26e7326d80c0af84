"""Supply control in every step: button, and order of the relay."""

import pytest

from tests.support.supply_rig import EPSILON, FALL, Supply
from twind.loop.procedures.procedure_runner import Priority, Procedure
from twind.loop.procedures.supply_control import SupplyControl
from twind.power.power_states import ButtonState, RelayState
from twind.power.supply_sequence import MORE
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode

# s: as docs/safety.md states them
CUT_WITHIN, STARTS, LOST = 0.2, 5.0, 2.0


@pytest.fixture
def rig() -> Supply:
    return Supply()


def stays_away() -> Procedure:
    while True:
        yield


# ----------------------------------------------------------------------------------- which parts there are


def test_without_a_power_process_nothing_happens() -> None:
    rig = Supply()
    rig.control = SupplyControl(rig, None, rig.begin_stop)
    rig.serve(10.0)
    rig.control.beat()
    rig.control.close()
    assert (rig.control.relay_text, rig.control.button_text) == (None, None)
    assert rig.control.findings == [] and rig.stops == []


def test_parts_that_the_robot_lacks_are_neither_shown_nor_judged() -> None:
    button = Supply(relay=False)
    button.child.relay = RelayState.FAILED
    button.serve()
    assert (button.control.relay_text, button.control.button_text) == (None, "released")
    assert button.control.findings == [] and not button.wanted()
    relay = Supply(level=None)
    relay.child.button = ButtonState.UNKNOWN
    for _ in range(3):
        relay.serve(STARTS + LOST)
    assert (relay.control.relay_text, relay.control.button_text) == ("open", None)
    assert relay.stops == [] and relay.wanted()
    assert relay.control.button is ButtonState.UNKNOWN


def test_a_process_is_begun_in_mirror_and_live_alone_and_goes_on_in_sim(rig: Supply) -> None:
    rig.child.pid = None
    rig.condition.mode = Mode.SIM
    rig.serve()
    assert rig.child.supervised == [] and rig.control.relay is RelayState.UNKNOWN
    rig.condition.mode = Mode.MIRROR
    rig.serve()
    assert rig.child.supervised == [rig.clock.now()] and rig.control.relay is RelayState.OPEN
    rig.child.pid = 4
    rig.condition.mode = Mode.SIM
    rig.serve()
    assert len(rig.child.supervised) == 2


def test_the_end_of_the_loop_ends_the_process(rig: Supply) -> None:
    rig.control.close()
    assert rig.child.closed == 1


# ----------------------------------------------------------------------------------- button


@pytest.mark.parametrize("level", ["settle", "cut"])
@pytest.mark.parametrize(
    ("state", "text"),
    [
        (ButtonState.PRESSED, "the stop button is pressed"),
        (ButtonState.UNPLUGGED, "the stop button is unplugged or cannot be read"),
    ],
)
def test_a_button_begins_one_e_stop_of_its_level(level: str, state: ButtonState, text: str) -> None:
    rig = Supply(level=level)
    rig.press(ButtonState.RELEASED)
    assert rig.stops == []
    rig.press(state)
    rig.press(state)
    assert rig.stops == [(level, text)]
    [event] = rig.book.events
    assert (event.level, event.code, event.message) == ("error", "ESTOP", text)
    assert [(each.code, each.message) for each in event.findings] == [(ReasonCode.ESTOP, text)]
    assert rig.control.button_text == state.name.lower()
    assert rig.control.findings == []


def test_a_change_of_the_button_and_a_reset_while_it_is_pressed_begin_the_stop_again(rig: Supply) -> None:
    rig.press()
    rig.press(ButtonState.UNPLUGGED)
    assert len(rig.stops) == 2
    rig.condition.acknowledge([ReasonCode.ESTOP])
    rig.press(ButtonState.UNPLUGGED)
    assert len(rig.stops) == 3


def test_a_button_begins_its_stop_also_where_a_client_has_latched_one(rig: Supply) -> None:
    rig.condition.latch(Finding(ReasonCode.ESTOP, message="e-stop (settle)"))
    rig.press(ButtonState.RELEASED)
    assert rig.stops == []
    rig.press()
    rig.press()
    assert len(rig.stops) == 1


def test_in_sim_a_pressed_button_stops_nothing_and_in_mirror_it_does(rig: Supply) -> None:
    rig.condition.mode = Mode.SIM
    rig.press()
    assert rig.stops == [] and rig.control.button is ButtonState.PRESSED
    rig.condition.mode = Mode.MIRROR
    rig.press()
    assert len(rig.stops) == 1


def test_a_button_that_was_never_read_bars_arming_and_stops_after_five_seconds(rig: Supply) -> None:
    rig.press(ButtonState.UNKNOWN)
    rig.serve(STARTS)
    assert rig.stops == []
    [finding] = rig.control.findings
    assert (finding.code, finding.message) == (ReasonCode.HW_DISCONNECTED, "the stop button is not read")
    rig.condition.mode = Mode.SIM
    assert rig.control.findings == []
    rig.condition.mode = Mode.LIVE
    rig.serve(EPSILON)
    assert rig.stops == [("settle", "the stop button is not read")]


def test_a_button_that_is_read_no_longer_stops_after_two_seconds_each_time(rig: Supply) -> None:
    for _ in range(2):
        rig.stops.clear()
        rig.condition.acknowledge([ReasonCode.ESTOP])
        rig.press(ButtonState.RELEASED)
        rig.serve(10.0)
        rig.press(ButtonState.UNKNOWN)
        rig.serve(LOST)
        assert rig.stops == []
        rig.serve(EPSILON)
        assert len(rig.stops) == 1


# ----------------------------------------------------------------------------------- order of the relay


def test_the_relay_closes_without_torque_and_procedure_once_it_was_open_long_enough(rig: Supply) -> None:
    rig.serve()
    rig.serve(FALL + MORE - EPSILON)
    assert not rig.wanted()
    assert rig.own(Priority.ARM, stays_away)
    rig.serve(2 * EPSILON)
    assert not rig.wanted()
    rig.procedures.abandon()
    rig.serve()
    assert rig.wanted()


def test_the_relay_does_not_close_under_torque(rig: Supply) -> None:
    rig.hold()
    rig.serve()
    rig.serve(FALL + MORE)
    assert not rig.wanted()


def test_a_button_that_is_pressed_while_the_relay_is_about_to_close_keeps_it_open(rig: Supply) -> None:
    rig.hardware.slow.torque[:] = -1  # no device has a supply
    rig.serve()
    rig.serve(FALL + MORE)
    assert rig.wanted()
    rig.press()
    assert not rig.wanted()
    rig.press(ButtonState.RELEASED)
    assert not rig.wanted()


@pytest.mark.parametrize("state", [ButtonState.UNKNOWN, ButtonState.PRESSED, ButtonState.UNPLUGGED])
def test_the_relay_closes_with_a_released_button_and_no_stop_alone(rig: Supply, state: ButtonState) -> None:
    rig.hardware.slow.torque[:] = -1
    rig.press(state)
    rig.serve(FALL + MORE)
    assert not rig.wanted()
    rig.press(ButtonState.RELEASED)
    assert rig.wanted() is (state is ButtonState.UNKNOWN)
    rig.condition.acknowledge([ReasonCode.ESTOP])
    rig.serve()
    assert rig.wanted()


def test_after_a_stop_the_relay_opens_once_torque_reads_off_everywhere(rig: Supply) -> None:
    rig.close_relay()
    rig.hardware.slow.torque[:] = (0, 1, 0)
    rig.press()
    rig.serve(10.0)
    assert rig.wanted()
    rig.hardware.slow.torque[:] = (0, -1, 0)
    rig.serve()
    assert rig.wanted()
    rig.hardware.slow.torque[:] = 0
    rig.serve()
    assert not rig.wanted()


@pytest.mark.parametrize("rank", tuple(Priority))
def test_the_relay_opens_after_the_stop_has_ended_and_other_procedures_do_not_matter(
    rig: Supply, rank: Priority
) -> None:
    rig.close_relay()
    rig.hardware.slow.torque[:] = 0
    assert rig.own(rank, stays_away)
    rig.press()
    assert rig.wanted() is (rank in (Priority.ESTOP, Priority.CUT))


def test_at_level_cut_the_relay_opens_after_a_fifth_of_a_second_whatever_torque_reads() -> None:
    rig = Supply(level="cut")
    rig.close_relay()
    rig.hardware.slow.torque[:] = 1
    rig.clock.time = 0.0
    rig.press()
    rig.clock.time = 0.01 + CUT_WITHIN - EPSILON
    rig.serve()
    assert rig.wanted()
    rig.clock.time = 0.01 + CUT_WITHIN
    rig.serve()
    assert not rig.wanted()


def test_a_stop_by_a_client_opens_no_relay(rig: Supply) -> None:
    rig.close_relay()
    rig.condition.latch(Finding(ReasonCode.ESTOP, message="e-stop (cut)"))
    rig.serve(1.0)
    assert rig.wanted()


def test_a_stop_that_a_reset_has_ended_opens_no_relay_later(rig: Supply) -> None:
    rig.close_relay()
    rig.hardware.slow.torque[:] = 1
    rig.press()
    rig.press(ButtonState.RELEASED)
    rig.condition.acknowledge([ReasonCode.ESTOP])
    rig.serve()
    rig.hardware.slow.torque[:] = 0
    rig.condition.latch(Finding(ReasonCode.ESTOP, message="e-stop (settle)"))
    rig.serve()
    assert rig.wanted()


def test_in_sim_the_relay_opens(rig: Supply) -> None:
    rig.close_relay()
    rig.condition.mode = Mode.SIM
    rig.serve()
    assert not rig.wanted()
