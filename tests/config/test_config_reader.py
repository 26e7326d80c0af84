"""Structs read from a file: type, bound, unit twin, unknown key; each error at its place, with what to do."""

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import pytest
from msgspec import Meta

from twind.config.config_reader import ConfigReader, ConfigStruct, Name, Plain, Text, bounds_text, keys_of
from twind.config.yaml_tree import ConfigError, parse

Count = Annotated[int, Meta(ge=0, le=252)]
Rate = Annotated[float, Meta(ge=10.0, le=1000.0)]
Positive = Annotated[float, Meta(gt=0.0)]


@dataclass(frozen=True)
class Gains:
    """A dataclass may be a shape too."""

    p: Count
    i: Count = 3


class SampleKeys(ConfigStruct, kw_only=True):
    """One key of each kind."""

    id: Count = 1
    rate: Rate | None = None
    speed_rad_s: Positive | None = None
    name: Name | None = None
    text: Text = "word"
    mode: Literal["sim", "mirror"] = "sim"
    sign: Literal[1, -1] = 1
    flag: bool = False
    limits_rad: tuple[float, float] | None = None
    pair: tuple[int, int] | None = None
    names: tuple[str, ...] = ()
    pairs: tuple[tuple[Text, Text], ...] = ()
    ports: dict[str, Text] | None = None
    gains: Gains | None = None
    proof: Any = None


def reader(text: str) -> ConfigReader:
    return ConfigReader("robot.yaml", parse(text, "robot.yaml"))


def sample(text: str) -> SampleKeys:
    return reader(text).read(SampleKeys)


def refused(text: str) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        sample(text)
    return caught.value


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("id: true", "1:5: id: a whole number is expected, found a truth value (True)"),
        ("id: 1.0", "a whole number is expected, found a number (1.0)"),
        ("id: '3'", "found text ('3')"),
        ("id: 300", "id: 300 is outside >= 0 and <= 252"),
        ("rate: true", "a number is expected, found a truth value"),
        ("rate: 1e3", "1e3 is text in YAML, not a number: write it as a decimal, 1.0e+3"),
        ("rate: -.5", "-.5 is text in YAML"),
        ("rate: 0o17", "0o17 is text in YAML"),
        ("rate: '100'", "100 is text in YAML, not a number: write it without quotes"),
        ("rate: fast", "a number is expected, found text ('fast')"),
        ("rate: 5", "5 is outside >= 10 and <= 1000"),
        ("rate:", "a number is expected, found nothing"),
        ("rate: [1]", "found a list"),
        ("rate: .nan", ".nan is not a finite number"),
        ("rate: -.inf", "-.inf is not a finite number"),
        ("rate: 1.0e+999", "write a finite decimal number"),
        ("speed_rad_s: 0", "speed_rad_s: 0 is outside > 0"),
        ("speed_deg_s: -180", "speed_deg_s: -3.14159 is outside > 0"),
        ("name: Ada", "name: 'Ada' has a wrong form; use 1 to 64 of a-z, 0-9, _ and -"),
        ('name: "ada\\n"', "use 1 to 64 of a-z"),
        ("text: 7", "text is expected, found a whole number (7); quote it"),
        ("text: ''", "must not be empty"),
        ("text:", "text is expected, found nothing"),
        ("mode: mirrow", "'mirrow' is none of sim, mirror; nearest: mirror"),
        ("mode: 1", "text is expected, found a whole number (1); quote it"),
        ("mode: [sim]", "text is expected, found a list"),
        ("sign: 2", "2 is none of 1, -1"),
        ("sign: [1]", "a whole number is expected, found a list"),
        ("id: [1]", "a whole number is expected, found a list"),
        ("name: {a: 1}", "text is expected, found a mapping"),
        ("sign: true", "a whole number is expected, found a truth value"),
        ("flag: 1", "true or false is expected, found a whole number"),
        ("limits_rad: 3", "a list is expected, found a whole number"),
        ("limits_rad: [1]", "needs 2 values, found 1"),
        ("limits_rad: [1, x]", "1:17: limits_rad[1]: a number is expected"),
        ("limits_deg: [1, true]", "1:17: limits_deg[1]: a number is expected"),
        ("pair: [1, 2.5]", "1:11: pair[1]: a whole number is expected, found a number (2.5)"),
        ("pair: [1]", "needs 2 values"),
        ("names: [a, 1]", "names[1]: text is expected"),
        ("names:", "a list is expected, found nothing"),
        ("pairs: [[a, b], [c]]", "1:17: pairs[1]: needs 2 values, found 1"),
        ("pairs: [[a, '']]", "1:13: pairs[0][1]: must not be empty"),
        ("ports: x", "a mapping is expected, found text ('x')"),
        ("ports: {main: 3}", "ports.main: text is expected"),
        ("gains: 1", "a mapping is expected, found a whole number"),
        ("gains: {i: 1}", "gains.p: is required and missing"),
        ("gains: {p: -1}", "1:12: gains.p: -1 is outside >= 0 and <= 252"),
        ("gains: {p: 1, q: 1}", "1:15: gains.q: unknown key; known: p, i"),
        ("limts_rad: [1, 2]", "1:1: limts_rad: unknown key; nearest: limits_rad"),
    ],
)
def test_a_wrong_value_is_refused_with_place_value_and_bound(text: str, message: str) -> None:
    error = refused(text)
    assert message in str(error)
    assert error.line == 1


def test_right_values_come_back_typed() -> None:
    found = sample(
        "id: 3\nrate: 30\nname: ada\nflag: true\nlimits_rad: [1, 2.5]\npair: [1, 2]\nnames: [x, '']\n"
        "pairs: [[a, b]]\nports: {m: /dev/a}\ngains: {p: 1}\nproof: {k: [1, {z: null}]}\n"
    )
    assert (found.id, found.rate, found.name, found.flag) == (3, 30.0, "ada", True)
    assert isinstance(found.rate, float)
    assert (found.limits_rad, found.pair, found.names) == ((1.0, 2.5), (1, 2), ("x", ""))
    assert (found.pairs, found.ports, found.gains) == ((("a", "b"),), {"m": "/dev/a"}, Gains(1, 3))
    assert found.proof == {"k": [1, {"z": None}]}


def test_an_empty_mapping_gives_the_defaults() -> None:
    assert sample("{}") == SampleKeys()


def test_null_is_a_value_of_a_plain_key_alone() -> None:
    assert sample("proof:").proof is None
    assert "found nothing" in str(refused("name:"))


def test_dropped_nulls_count_as_absent() -> None:
    section = reader("{name: null, rate: null}").drop_nulls("name")
    assert list(section) == ["rate"]
    with pytest.raises(ConfigError, match="rate: a number is expected"):
        section.read(SampleKeys)


def test_degrees_are_a_twin_of_radians() -> None:
    found = sample("limits_deg: [-90, 180]\nspeed_deg_s: 360\n")
    assert found.limits_rad == pytest.approx((-math.pi / 2, math.pi))
    assert found.speed_rad_s == pytest.approx(2 * math.pi)
    assert sample("speed_rad_s: 2").speed_rad_s == 2.0


def test_the_numbers_of_a_section_in_degrees_are_degrees() -> None:
    assert reader("stop_deg: {upper: 180}").section("stop_rad").value("upper", float) == math.radians(180.0)


def test_both_twins_are_refused_even_when_they_agree() -> None:
    message = str(refused("limits_rad: [0, 0]\nlimits_deg: [0, 0]\n"))
    assert message == "robot.yaml:2:1: limits_deg: limits_rad is given too: keep one of them"


def test_an_unknown_key_unlike_any_other_lists_the_known() -> None:
    with pytest.raises(ConfigError, match=r"robot.yaml:1:1: zzz: unknown key; known: p, i"):
        reader("zzz: 3\n").read(Gains)


def test_keys_of_a_shape_beside_are_known_and_not_read() -> None:
    assert reader("p: 1\nname: 7\n").read(Gains, SampleKeys) == Gains(1)


def test_a_fixed_field_is_no_key_of_the_file() -> None:
    assert reader("p: 1").read(Gains, i=9) == Gains(1, 9)
    with pytest.raises(ConfigError, match="i: unknown key"):
        reader("{p: 1, i: 2}").read(Gains, i=9)


def test_an_inherited_value_yields_to_an_own_one_and_is_refused_at_its_own_place() -> None:
    top = reader("defaults: {speed_deg_s: 180, rate: 5}\njoint: {speed_rad_s: 1, id: 2}\nother: {}\n")
    keys = ("speed_rad_s", "rate")
    own = top.section("joint").inherit(top.section("defaults"), ("speed_rad_s",)).read(SampleKeys)
    assert (own.speed_rad_s, own.rate, own.id) == (1.0, None, 2)
    assert top.section("other").inherit(top.section("defaults"), keys).value("speed_rad_s", float) == math.pi
    with pytest.raises(ConfigError, match=r"robot.yaml:1:36: defaults\.rate: 5 is outside"):
        top.section("other").inherit(top.section("defaults"), keys).read(SampleKeys)


def test_paths_name_every_level() -> None:
    inner = reader("joints:\n  knee:\n    id: x\n").section("joints").section("knee")
    with pytest.raises(ConfigError, match=r"robot.yaml:3:9: joints\.knee\.id: "):
        inner.read(SampleKeys)


def test_a_choice_names_what_there_is() -> None:
    assert reader("bus: leg").choice("bus", ["leg", "arm"]) == "leg"
    with pytest.raises(ConfigError, match="'legs' is none of leg, arm; nearest: leg"):
        reader("bus: legs").choice("bus", ["leg", "arm"])
    with pytest.raises(ConfigError, match="'leg' is not described: the file describes none"):
        reader("bus: leg").choice("bus", [])


def test_another_format_is_refused_before_any_key() -> None:
    with pytest.raises(ConfigError, match="format: 'b/2' is not a/1"):
        reader("{strange: 1, format: b/2}").require_format("a/1")


def test_a_plain_value_is_what_stands_there() -> None:
    found: Plain = reader("a: [1, x]").plain("a")
    assert found == [1, "x"]
    assert reader("a: 1").plain("b") is None


def test_keys_of_a_shape_tell_which_are_required() -> None:
    assert {key: field.required for key, field in keys_of(Gains).items()} == {"p": True, "i": False}


def test_bounds_are_written_with_their_signs() -> None:
    assert bounds_text([Meta(gt=0), Meta(le=2.5)]) == "> 0 and <= 2.5"
