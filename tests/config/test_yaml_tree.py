"""YAML as a tree that knows its places, with every trap of YAML 1.1 refused."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.config.yaml_tree import (
    MAX_BYTES,
    MAX_DEPTH,
    ConfigError,
    YamlMapping,
    YamlScalar,
    YamlSequence,
    parse,
    read_text,
)


def refused(text: str) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        parse(text, "robot.yaml")
    return caught.value


def leaf(text: str) -> object:
    node = parse(f"key: {text}", "robot.yaml").items["key"]
    assert isinstance(node, YamlScalar)
    return node.value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1),
        ("-17", -17),
        ("+3", 3),
        ("0", 0),
        ("0.5", 0.5),
        ("1.0e+3", 1000.0),
        ("1.0e-3", 0.001),
        ("5.", 5.0),
        (".5", 0.5),
        ("true", True),
        ("False", False),
        ("null", None),
        ("~", None),
        ("", None),
        ("word", "word"),
        ("'on'", "on"),
        ('"010"', "010"),
        ("'.nan'", ".nan"),
        ("1e3", "1e3"),  # text in YAML 1.1: whoever asks for a number is told (test_section)
        ("-.5", "-.5"),
    ],
)
def test_a_plain_scalar_has_the_expected_value_and_type(text: str, value: object) -> None:
    found = leaf(text)
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("on", "truth value"),
        ("off", "truth value"),
        ("yes", "truth value"),
        ("No", "truth value"),
        ("TRUE", "truth value"),
        ("010", "reads 010 as 8"),
        ("0x1F", "reads 0x1F as 31"),
        ("0b11", "reads 0b11 as 3"),
        ("12:30", "base 60"),
        ("1:30.5", "base 60"),
        ("1_000", "underscores"),
        ("1_0.5", "finite decimal"),
        ("9" * 5000, "at most 18 digits"),
        (".nan", "not a finite number"),
        (".inf", "not a finite number"),
        ("-.Inf", "not a finite number"),
        ("1.0e+999", "finite decimal"),
        ("2026-11-21", "date"),
        ("2026-11-21T09:14:03Z", "date"),
        ("=", "special meaning"),
    ],
)
def test_a_scalar_that_yaml_reads_otherwise_is_refused_at_its_place(text: str, why: str) -> None:
    error = refused(f"first: 1\nkey: {text}\n")
    assert why in str(error)
    assert (error.line, error.column) == (2, 6)
    assert str(error).startswith("robot.yaml:2:6: ")
    assert len(str(error)) < 300


@pytest.mark.parametrize(
    ("text", "why", "line"),
    [
        ("a: &x 1\n", "anchor &x", 1),
        ("a: 1\nb: *x\n", "alias *x", 2),
        ("a: !!str 1\n", "tag", 1),
        ("a: ! 1\n", "tag", 1),
        ("a: !!python/object:os.system {}\n", "tag", 1),
        ("a: 1\nb: 2\na: 3\n", "duplicate key 'a', first at line 1", 3),
        ("a: {b: 1, b: 2}\n", "duplicate key 'b'", 1),
        ("<<: {a: 1}\n", "merge", 1),
        ("on: 1\n", "truth value", 1),
        ("1: a\n", "a key must be text, found 1", 1),
        ("~: a\n", "a key must be text, found None", 1),
        ("[a]: 1\n", "a key must be text", 1),
        ("? {a: 1}\n: 1\n", "a key must be text", 1),
        ("- 1\n", "mapping", 1),
        ("word\n", "mapping", 1),
        ("a: 1\n---\nb: 2\n", "second document", 2),
        ("%YAML 1.1\n---\na: 1\n", "directives", 1),
        ("a: [1, 2\n", "not YAML", 2),
        ("a: 1\n\tb: 2\n", "not YAML", 2),
        ("a: 'open\n", "not YAML", 2),
    ],
)
def test_an_unsupported_yaml_feature_is_refused_with_its_line(text: str, why: str, line: int) -> None:
    error = refused(text)
    assert why in str(error)
    assert error.line == line


@pytest.mark.parametrize("text", ["", "\n", "# nothing but a comment\n", "---\n"])
def test_an_empty_file_is_refused(text: str) -> None:
    assert "empty" in str(refused(text)) or "mapping" in str(refused(text))


@pytest.mark.parametrize("text", ["a: \x00\n", "a: \x07\n", "a: \ufffe\n", "a: \ud800\n"])
def test_characters_that_yaml_does_not_allow_are_refused(text: str) -> None:
    assert "robot.yaml" in str(refused(text))


@pytest.mark.parametrize("depth", [MAX_DEPTH + 1, 1200, 60_000])
@pytest.mark.parametrize("opening", ["[", "{a: "])
def test_deep_nesting_is_refused_before_it_recurses(depth: int, opening: str) -> None:
    assert f"more than {MAX_DEPTH} deep" in str(refused("a: " + opening * depth))


def test_nesting_up_to_the_bound_is_read() -> None:
    parse("a: " + "[" * (MAX_DEPTH - 1) + "]" * (MAX_DEPTH - 1), "robot.yaml")


def test_the_billion_laughs_are_refused_at_the_first_anchor() -> None:
    text = "a: &a [1, 1]\n" + "".join(
        f"{b}: &{b} [*{a}, *{a}]\n" for a, b in zip("abcdef", "bcdefg", strict=True)
    )
    assert refused(text).line == 1


def test_every_node_and_key_has_its_position() -> None:
    tree = parse("joints:\n  knee: {id: 34,\n         limits: [0.0, 2.1]}\n", "robot.yaml")
    joints = tree.items["joints"]
    assert isinstance(joints, YamlMapping)
    knee = joints.items["knee"]
    assert isinstance(knee, YamlMapping)
    assert (joints.keys["knee"].line, joints.keys["knee"].column) == (2, 3)
    limits = knee.items["limits"]
    assert isinstance(limits, YamlSequence)
    assert (limits.items[1].mark.line, limits.items[1].mark.column) == (3, 24)


def test_a_file_that_is_too_large_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "big.yaml"
    path.write_bytes(b"#" * (MAX_BYTES + 1))
    with pytest.raises(ConfigError, match="larger than 256 KiB"):
        read_text(path)
    path.write_bytes(b"#" * MAX_BYTES)
    assert len(read_text(path)) == MAX_BYTES
    assert "larger than" in str(refused("#" * (MAX_BYTES + 1)))


def test_a_file_that_cannot_be_read_is_named_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"absent\.yaml: cannot be read: No such file"):
        read_text(tmp_path / "absent.yaml")
    with pytest.raises(ConfigError, match="is a folder, not a file"):
        read_text(tmp_path)


def test_bytes_that_are_not_utf8_are_refused_at_their_place(tmp_path: Path) -> None:
    path = tmp_path / "latin.yaml"
    path.write_bytes(b"a: 1\nb: gr\xfcn\n")
    with pytest.raises(ConfigError) as caught:
        read_text(path)
    assert (caught.value.line, caught.value.column) == (2, 6)


def file_blamed(text: str) -> str:
    """The file that the refusal names; the same where there is none."""
    try:
        parse(text, "robot.yaml")
    except ConfigError as error:
        return error.file
    return "robot.yaml"


@given(st.text(max_size=60))
def test_any_text_is_read_or_refused_but_never_breaks(text: str) -> None:
    assert file_blamed(text) == "robot.yaml"


@given(st.text("ab:-[]{}&*!'\"\n %#?1.e+_", max_size=40))
def test_any_yaml_like_text_is_read_or_refused_but_never_breaks(text: str) -> None:
    assert file_blamed("key: " + text) == "robot.yaml"
