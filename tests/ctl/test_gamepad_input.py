"""A gamepad: nothing is held without the dead-man button, and what is lost or out of rest holds nothing."""

from collections.abc import Iterator

import pytest

pytest.importorskip("evdev", reason="no evdev on this machine: extra gamepad")

from evdev import ecodes

from tests.support.gamepad_rig import PipeGamepad
from twind.command_line.verb import UsageError
from twind.ctl.teleoperating.gamepad_input import GamepadInput, open_gamepad
from twind.robot_client.jog_motion import HOLD


@pytest.fixture
def pad() -> Iterator[PipeGamepad]:
    made = PipeGamepad()
    yield made
    made.close()


@pytest.fixture
def controls(pad: PipeGamepad) -> GamepadInput:
    made = GamepadInput(pad)
    made.dead_man = "BTN_TL"
    return made


def test_the_controls_are_named_as_the_kernel_names_them(controls: GamepadInput) -> None:
    assert {"BTN_SOUTH", "BTN_EAST", "BTN_TL", "ABS_X", "ABS_HAT0Y-", "ABS_HAT0Y+"} <= set(controls.controls)


def test_only_the_dead_man_button_lets_the_others_count(pad: PipeGamepad, controls: GamepadInput) -> None:
    pad.key("BTN_SOUTH", 1)
    controls.take(10.0)
    assert controls.held(10.0) == {} and controls.pressed() == ["BTN_SOUTH"]
    pad.key("BTN_TL", 1)
    pad.axis("ABS_X", -32768)
    controls.take(10.02)
    assert controls.held(10.02) == {"BTN_SOUTH": 1.0, "ABS_X": -1.0, "ABS_X-": 1.0}
    pad.key("BTN_TL", 0)
    controls.take(10.04)
    assert controls.held(10.04) == {}


def test_an_axis_counts_from_its_dead_zone_to_its_end(pad: PipeGamepad, controls: GamepadInput) -> None:
    pad.key("BTN_TL", 1)
    found = []
    for value in (0, 3000, -3000, 18022, 32767):
        pad.axis("ABS_X", value)
        controls.take(10.0)
        found.append(controls.held(10.0).get("ABS_X", 0.0))
    assert found == pytest.approx([0.0, 0.0, 0.0, 0.5, 1.0], abs=1e-3)
    pad.axis("ABS_Z", 255)
    controls.take(10.0)
    assert controls.held(10.0)["ABS_Z"] == 1.0


@pytest.mark.parametrize("when", ["opened", "pressed"])
def test_an_axis_that_is_deflected_before_must_return_to_rest_first(when: str) -> None:
    pad = PipeGamepad(ABS_X=32767 if when == "opened" else 0)
    controls = GamepadInput(pad)
    controls.dead_man = "BTN_TL"
    if when == "pressed":
        pad.axis("ABS_X", 32767)
    pad.key("BTN_TL", 1)
    pad.axis("ABS_X", 30000)
    controls.take(10.0)
    assert controls.held(10.0) == {}
    pad.axis("ABS_X", 0)
    pad.axis("ABS_X", 32767)
    controls.take(10.02)
    assert controls.held(10.02) == {"ABS_X": 1.0, "ABS_X+": 1.0}
    controls.close()


def test_an_unplugged_gamepad_is_lost(pad: PipeGamepad, controls: GamepadInput) -> None:
    pad.key("BTN_TL", 1)
    controls.take(10.0)
    pad.unplug()
    with pytest.raises(EOFError, match="Test pad: unplugged"):
        controls.take(10.02)


def test_lost_events_and_a_pause_of_this_process_release_the_dead_man_button(
    pad: PipeGamepad, controls: GamepadInput
) -> None:
    pad.key("BTN_TL", 1)
    pad.key("BTN_SOUTH", 1)
    controls.take(10.0)
    assert controls.held(10.0)
    controls.take(10.0 + 1.01 * HOLD)
    assert controls.held(10.16) == {}
    pad.key("BTN_TL", 0)
    pad.key("BTN_TL", 1)
    controls.take(10.17)
    assert controls.held(10.17) == {"BTN_SOUTH": 1.0}
    pad.write_events((ecodes.EV_SYN, ecodes.SYN_DROPPED, 0))
    controls.take(10.18)
    assert controls.held(10.18) == {}


def test_a_device_that_cannot_be_opened_is_named() -> None:
    with pytest.raises(UsageError, match="/dev/null"):
        open_gamepad("/dev/null")
