"""Typed getters: type, bound, unit twin, unknown key; each error at its place, with what to do."""

import math
from collections.abc import Callable

import pytest

from twind.config.config_section import ConfigSection
from twind.config.yaml_tree import ConfigError, parse


def section(text: str) -> ConfigSection:
    return ConfigSection("robot.yaml", parse(text, "robot.yaml"))


def refused(text: str, ask: Callable[[ConfigSection], object]) -> str:
    with pytest.raises(ConfigError) as caught:
        ask(section(text))
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "ask", "message"),
    [
        (
            "id: true",
            lambda s: s.integer("id"),
            "1:5: id: a whole number is expected, found a truth value (True)",
        ),
        ("id: 1.0", lambda s: s.integer("id"), "a whole number is expected, found a number (1.0)"),
        ("id: '3'", lambda s: s.integer("id"), "found text ('3')"),
        ("id: 300", lambda s: s.integer("id", least=0, most=252), "id: 300 is outside >= 0 and <= 252"),
        ("rate: true", lambda s: s.number("rate"), "a number is expected, found a truth value"),
        (
            "rate: 1e3",
            lambda s: s.number("rate"),
            "1e3 is text in YAML, not a number: write it as a decimal, 1.0e+3",
        ),
        ("rate: -.5", lambda s: s.number("rate"), "-.5 is text in YAML"),
        ("rate: 0o17", lambda s: s.number("rate"), "0o17 is text in YAML"),
        (
            "rate: '100'",
            lambda s: s.number("rate"),
            "100 is text in YAML, not a number: write it without quotes",
        ),
        ("rate: fast", lambda s: s.number("rate"), "a number is expected, found text ('fast')"),
        ("rate: 0", lambda s: s.number("rate", above=0.0), "rate: 0 is outside > 0"),
        ("rate: 5", lambda s: s.number("rate", least=10.0, most=1000.0), "5 is outside >= 10 and <= 1000"),
        ("rate:", lambda s: s.number("rate"), "found nothing"),
        ("rate: [1]", lambda s: s.number("rate"), "found a list"),
        ("name: 7", lambda s: s.text("name"), "text is expected, found a whole number (7); quote it"),
        ("name: ''", lambda s: s.text("name"), "must not be empty"),
        ("name:", lambda s: s.text("name"), "text is expected, found nothing"),
        (
            "mode: mirrow",
            lambda s: s.text("mode", None, ("sim", "mirror")),
            "none of sim, mirror; nearest: mirror",
        ),
        ("flag: 1", lambda s: s.flag("flag"), "true or false is expected, found a whole number"),
        ("limits: 3", lambda s: s.numbers("limits"), "a list is expected, found a whole number"),
        ("limits: [1]", lambda s: s.numbers("limits", 2), "needs 2 numbers, found 1"),
        ("limits: [1, x]", lambda s: s.numbers("limits", 2), "1:13: limits[1]: a number is expected"),
        (
            "pair: [1, 2.5]",
            lambda s: s.integers("pair", 2),
            "whole numbers is expected, found a number (2.5)",
        ),
        ("pair: [1]", lambda s: s.integers("pair", 2), "needs 2 whole numbers"),
        ("names: [a, 1]", lambda s: s.texts("names"), "a list of names is expected"),
        ("model: x", lambda s: s.section("model"), "a mapping is expected, found text ('x')"),
        ("other: 1", lambda s: s.number("rate"), "rate: is required and missing"),
        (
            "limts_rad: [1, 2]",
            lambda s: s.numbers("limits_rad"),
            "1:1: limts_rad: unknown key; nearest: limits_rad",
        ),
    ],
)
def test_a_wrong_value_is_refused_with_place_value_and_bound(
    text: str, ask: Callable[[ConfigSection], object], message: str
) -> None:
    found = refused(text, ask)
    assert message in found
    assert found.startswith("robot.yaml:1:")


def test_right_values_come_back_typed() -> None:
    s = section("a: 3\nb: 3\nc: word\nd: true\ne: [1, 2.5]\nf: [1, 2]\ng: [x]\nh: {k: [1, {z: null}]}\n")
    assert s.integer("a") == 3
    assert isinstance(s.number("b"), float)
    assert s.text("c") == "word"
    assert s.flag("d") is True
    assert s.numbers("e") == (1.0, 2.5)
    assert s.integers("f", 2) == (1, 2)
    assert s.texts("g") == ("x",)
    assert s.plain("h") == {"k": [1, {"z": None}]}
    s.close()


def test_what_is_absent_takes_its_default() -> None:
    s = section("x: {}\n")
    assert s.integer("a", 3) == 3
    assert s.number("b", 0.5) == 0.5
    assert s.text("c", "word") == "word"
    assert s.flag("d", False) is False
    assert s.texts("e") == ()
    assert s.plain("f") is None
    assert list(s.section("g")) == []


def test_degrees_are_a_twin_of_radians() -> None:
    s = section("limits_deg: [-90, 180]\nspeed_deg_s: 360\n")
    assert s.numbers("limits_rad", 2) == pytest.approx((-math.pi / 2, math.pi))
    assert s.number("speed_rad_s") == pytest.approx(2 * math.pi)
    s.close()
    assert section("speed_rad_s: 2").number("speed_rad_s") == 2.0


def test_both_twins_are_refused_even_when_they_agree() -> None:
    message = refused("limits_rad: [0, 0]\nlimits_deg: [0, 0]\n", lambda s: s.numbers("limits_rad"))
    assert message == "robot.yaml:2:1: limits_deg: limits_rad is given too: keep one of them"


def test_an_unknown_key_names_the_nearest_spelling() -> None:
    s = section("rate_hz: 100\nrate_hs: 3\n")
    s.number("rate_hz")
    with pytest.raises(ConfigError, match=r"robot.yaml:2:1: rate_hs: unknown key; nearest: rate_hz"):
        s.close()


def test_an_unknown_key_unlike_any_other_lists_the_known() -> None:
    s = section("zzz: 3\n")
    s.number("rate_hz", 1.0)
    s.flag("x", True)
    with pytest.raises(ConfigError, match=r"zzz: unknown key; known: rate_hz, x"):
        s.close()


def test_keys_given_to_close_are_known() -> None:
    section("knee: 1\n").close(also=["knee"])


def test_paths_name_every_level() -> None:
    inner = section("joints:\n  knee:\n    id: x\n").section("joints").section("knee")
    with pytest.raises(ConfigError, match=r"robot.yaml:3:9: joints\.knee\.id: "):
        inner.integer("id")
