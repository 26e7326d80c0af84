"""The interface definition is read as varlink defines it, and holds values to it."""

import re
from pathlib import Path

import pytest
from varlink.scanner import Interface as PeerInterface

from twind.exceptions import InvalidInput
from twind.protocol import CONTROL, SERVICE, load, parse
from twind.telemetry.timing_monitor import COMMAND, READING

CONTRACT = load(CONTROL)


def check(method: str, **parameters: object) -> None:
    CONTRACT.methods[method].parameters.check(parameters, "")


def refusal(method: str, **parameters: object) -> str:
    with pytest.raises(InvalidInput) as caught:
        check(method, **parameters)
    return str(caught.value)


@pytest.mark.parametrize("name", [CONTROL, SERVICE])
def test_every_member_that_is_written_is_read(name: str) -> None:
    interface = load(name)
    written = re.findall(r"^(?:type|method|error) (\w+)", interface.description, re.MULTILINE)
    assert sorted(written) == sorted([*interface.types, *interface.methods, *interface.errors])


def test_an_independent_reader_finds_the_same_methods() -> None:
    peer = PeerInterface(CONTRACT.description)
    assert peer.name == CONTRACT.name
    assert {name for name, member in peer.members.items() if hasattr(member, "in_type")} == set(
        CONTRACT.methods
    )


def test_optional_fields_may_be_absent_or_null() -> None:
    check("GetStatus")
    check("GetStatus", joints=None)
    check("GetStatus", joints=True)


def test_an_integer_is_a_float_and_a_bool_is_no_number() -> None:
    check("Setpoint", joint_names=["a"], positions=[1])
    assert "positions[1]: expected float, got bool" in refusal(
        "Setpoint", joint_names=["a"], positions=[1.0, True]
    )
    assert "id: expected int, got bool" in refusal("ReadRegister", bus="b", id=True, name="n")
    assert "id: expected int, got float" in refusal("ReadRegister", bus="b", id=1.0, name="n")


def test_a_number_beyond_64_bits_is_refused() -> None:
    assert "expected int" in refusal("ReadRegister", bus="b", id=1 << 63, name="n")
    assert "expected float" in refusal("Setpoint", joint_names=["a"], positions=[1 << 64])


def test_a_wrong_field_is_named_by_its_whole_path() -> None:
    points = [{"positions": [0.0], "time_from_start": 1.0}, {"positions": [None], "time_from_start": 2.0}]
    message = refusal("SubmitTrajectory", trajectory={"joint_names": ["a"], "points": points})
    assert message == "trajectory.points[1].positions[0]: expected float, got null"


def test_an_unknown_field_is_refused_with_the_known_ones() -> None:
    assert refusal("SetMode", mode="sim", force=True) == "force: unknown field; known: mode"
    assert "known: none" in refusal("Disarm", now=True)


def test_a_missing_field_is_named() -> None:
    assert refusal("SetMode") == "mode: is missing"
    assert refusal("Check", trajectory={"points": []}) == "trajectory.joint_names: is missing"


def test_maps_enums_and_inline_structs_are_understood() -> None:
    interface = parse("interface a.b\nmethod M(m: [string]int, c: (on, off), s: ?[](x: float)) -> ()")
    parameters = interface.methods["M"].parameters
    parameters.check({"m": {"k": 1}, "c": "on", "s": [{"x": 1.0}]}, "")
    for wrong, where in (
        ({"m": {"k": "1"}, "c": "on"}, "m.k"),
        ({"m": {}, "c": "up"}, "c"),
        ({"m": {}, "c": "on", "s": [{"x": ""}]}, "s[0].x"),
        ({"m": [], "c": "on"}, "m"),
    ):
        with pytest.raises(InvalidInput) as caught:
            parameters.check(wrong, "")
        assert caught.value.where == where


@pytest.mark.parametrize(
    "text",
    [
        "interface a.b\nmethod M( -> ()",
        "interface a.b\nmethod M(x: Missing) -> ()",
        "interface a.b\nvariable X ()",
        "interface a.b\ntype T (a: int, b)",
        "interface a.b\nmethod M() -> () $",
        "method M() -> ()",
        "interface a.b\nmethod M(",
        "interface a.b\nerror E (on, off)",
    ],
)
def test_a_definition_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(SyntaxError):
        parse(text)


def test_every_method_is_documented() -> None:
    page = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text("utf-8")
    for method in CONTRACT.methods:
        assert f"`{method}`" in page, method
    for error in CONTRACT.errors:
        assert error in page, error


def test_the_page_has_every_hop_and_no_other() -> None:
    page = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text("utf-8")
    rows = re.findall(r"^\| `(\w+)` \|", page.split("## Latency")[1].split("## ")[0], re.MULTILINE)
    assert rows == ["total", *READING, *COMMAND]
