"""Sections `power` and `stop_button` of a robot file."""

from pathlib import Path

import pytest

from tests.support.small_robot_file import SMALL, read
from twind.config.power_config import ButtonSpec, RelaySpec
from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput
from twind.loop.process.power_child import PowerChild


def test_a_robot_without_these_sections_has_neither(tmp_path: Path) -> None:
    robot = read(tmp_path)
    assert (robot.relay, robot.stop_button) == (None, None)


def test_the_keys_become_relay_and_button(tmp_path: Path) -> None:
    text = "power: {relay: {kind: gpio, port: /dev/gpiochip0, line: 17, active_low: true, timeout_ms: 80}}\n"
    text += "stop_button: {kind: key, port: /dev/input/event3, key: 28, level: cut}\n"
    robot = read(tmp_path, SMALL + text)
    assert robot.relay == RelaySpec("gpio", "/dev/gpiochip0", 17, True, 0.08, 1.0)
    assert robot.stop_button == ButtonSpec("key", "/dev/input/event3", "cut", -1, 28)


@pytest.mark.parametrize(
    ("text", "where", "why"),
    [
        ("power: {relay: {kind: gpio, port: a}}", "power.relay.line", "required with kind gpio"),
        ("power: {relay: {kind: rts, port: a, line: 1}}", "power.relay.line", "only kind gpio has it"),
        ("power: {relay: {kind: rts, port: a, active_low: true}}", "power.relay.active_low", "leave it out"),
        ("power: {relay: {kind: rts, port: a, timeout_ms: 55}}", "power.relay.timeout_ms", "at least 60"),
        ("power: {relay: {kind: rts}}", "power.relay.port", "required"),
        ("stop_button: {kind: key, port: a}", "stop_button.key", "required with kind key"),
        ("stop_button: {kind: cts, port: a, key: 1}", "stop_button.key", "only kind key has it"),
        ("stop_button: {kind: cts, port: a, level: hold}", "stop_button.level", "settle, cut"),
    ],
)
def test_keys_that_do_not_fit_are_refused_by_name(tmp_path: Path, text: str, where: str, why: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        read(tmp_path, SMALL + text + "\n")
    assert where in str(refusal.value)
    assert why in str(refusal.value)


def test_a_rate_of_the_command_line_is_checked_too() -> None:
    with pytest.raises(InvalidInput, match="at least 150"):
        PowerChild(RelaySpec("rts", "a", -1, False, 0.1, 1.0), None, 20.0)
