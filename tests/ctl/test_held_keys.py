"""The dead-man rule of a terminal: keys count by when the terminal proves that they were pressed."""

import pytest

from twind.ctl.teleoperating.held_keys import HeldKeys
from twind.ctl.teleoperating.terminal_codes import KeyEvent, TerminalKey
from twind.robot_client.jog_motion import HOLD


def key(name: str = "w", event: KeyEvent = KeyEvent.PRESSED) -> TerminalKey:
    return TerminalKey(name, event)


def proven(keys: HeldKeys, now: float) -> None:
    keys.ask(now)
    keys.answer()


def test_a_key_is_held_until_its_release() -> None:
    keys = HeldKeys(releases=True)
    for step in range(100):
        proven(keys, 10.0 + 0.02 * step)
        if step == 0:
            keys.take(key())
        assert keys.held(10.0 + 0.02 * step) == ("w",)
    assert keys.is_kept("w")
    keys.take(key(event=KeyEvent.RELEASED))
    assert keys.held(11.99) == ()


def test_a_key_lapses_when_the_terminal_answers_no_more_and_a_late_answer_revives_nothing() -> None:
    keys = HeldKeys(releases=True)
    proven(keys, 10.0)
    keys.take(key())
    for step in range(1, 20):
        keys.ask(10.0 + 0.02 * step)
    assert keys.held(10.0 + 0.99 * HOLD) == ("w",)
    assert keys.held(10.0 + 1.01 * HOLD) == ()
    for _ in range(19):
        keys.answer()
    keys.take(key(event=KeyEvent.REPEATED))  # it was held all the time: it must be pressed again
    assert keys.held(10.39) == ()
    keys.take(key())
    assert keys.held(10.39) == ("w",)


@pytest.mark.parametrize("releases", [True, False])
def test_a_press_that_waited_in_a_network_moves_nothing(releases: bool) -> None:
    keys = HeldKeys(releases=releases)
    proven(keys, 10.0)
    keys.ask(10.02)
    keys.take(key())  # it comes at 10.5, before the answer to the question of 10.02
    assert keys.held(10.5) == ()
    keys.take(key())
    keys.answer()
    assert keys.held(10.5) == ()


def test_without_releases_a_press_is_a_short_step_and_repeats_go_on() -> None:
    keys = HeldKeys(releases=False)
    proven(keys, 10.0)
    keys.take(key())
    assert keys.held(10.0 + 0.99 * HOLD) == ("w",) and not keys.is_kept("w")
    assert keys.held(10.0 + 1.01 * HOLD) == ()
    for step in range(30):  # the slowest repeat: 10.9 a second on the console
        now = 11.0 + 0.092 * step
        proven(keys, now)
        keys.take(key())
        assert keys.held(now + 0.091) == ("w",)
        assert keys.is_kept("w") == (step > 0)
    assert keys.held(now + 1.01 * HOLD) == ()


def test_a_window_that_loses_the_focus_drops_its_keys() -> None:
    keys = HeldKeys(releases=True)
    proven(keys, 10.0)
    keys.take(key("a"))
    keys.take(key("b"))
    assert keys.held(10.0) == ("a", "b")
    keys.drop_all()
    assert keys.held(10.0) == ()
    assert keys.is_answered


def test_time_that_is_not_known_holds_nothing() -> None:
    keys = HeldKeys(releases=True)
    proven(keys, 10.0)
    keys.take(key())
    assert keys.held(float("nan")) == ()
