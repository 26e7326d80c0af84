"""Strict JSON: extensions of Python's parser are refused, all valid JSON is accepted."""

import contextlib
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind.exceptions import InvalidInput
from twind.protocol.strict_json import DEPTH, loads

VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(1 << 60), 1 << 60)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


@examples(80)
@given(VALUES, st.booleans())
def test_valid_json_is_parsed_unchanged(value: object, ascii_only: bool) -> None:
    assert loads(json.dumps(value, ensure_ascii=ascii_only).encode()) == value


@examples(150)
@given(st.binary(max_size=40))
def test_any_bytes_are_a_value_or_bad_json(data: bytes) -> None:
    with contextlib.suppress(InvalidInput):
        loads(data)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b'{"a":1,"a":1}', "stands twice"),
        (b'[{"x":{"k":1,"b":2,"k":3}}]', "stands twice"),
        (b"NaN", "NaN"),
        (b"[Infinity]", "Infinity"),
        (b"[-Infinity]", "Infinity"),
        (b"1e999", "beyond a double"),
        (b"[-1e999]", "beyond a double"),
        (b"9" * 5000, "beyond 64 bits"),
        (b"\xff\xfe", "UTF-8"),
        (b'"\xed\xa0\x80"', "UTF-8"),
        (b'"\\ud800"', "surrogate"),
        (b"", "Expecting value"),
        (b"{} {}", "Extra data"),
        (b"{'a':1}", "Expecting property name"),
        (b"\xef\xbb\xbf{}", "Expecting value"),
        (b"[1,]", "Expecting value"),
    ],
)
def test_invalid_json_is_refused_with_a_reason(data: bytes, reason: str) -> None:
    with pytest.raises(InvalidInput, match=reason):
        loads(data)


@pytest.mark.parametrize("opening", [b"[", b'{"a":'])
def test_nesting_ends_at_sixteen(opening: bytes) -> None:
    closing = b"]" if opening == b"[" else b"}"
    loads(opening * DEPTH + b"0" + closing * DEPTH)
    for depth in (DEPTH + 1, 1000, 100_000):
        with pytest.raises(InvalidInput, match="nested"):
            loads(opening * depth + b"0" + closing * depth)


def test_brackets_inside_strings_are_no_nesting() -> None:
    text = "[" * 100 + '\\"' + "{" * 100
    assert loads(json.dumps([text, text, "\\"]).encode()) == [text, text, "\\"]


def test_a_hostile_string_costs_linear_time() -> None:
    data = b"[" * 5 + b'"' + b'\\"' * 500_000 + b"[" * 20  # quadratic work would be hours, not seconds
    with pytest.raises(InvalidInput):
        loads(data)
