"""Strict JSON: refuses what Python's parser accepts beyond the standard (BAD_JSON). Standard library only."""

import json
import re
from math import isfinite
from typing import Any, NoReturn

from twind.exceptions import InvalidInput

DEPTH = 16  # nested arrays and objects
_NESTING = re.compile(
    r'"(?:[^"\\]++|\\.?)*+"?|[][{}]', re.DOTALL
)  # strings whole, so that brackets in them do not count
_BRACKETS = bytes.maketrans(b"{}", b"[]")
_PLAIN = bytes(set(range(256)) - set(b'[]{}"'))
_DIGITS = 20  # a longer integer does not fit 64 bits, and is not converted
_LEAST = -(2**63)
_MOST = 2**64 - 1


def loads(data: bytes | bytearray | memoryview) -> Any:
    """The value of one JSON text. Raises InvalidInput on invalid UTF-8, duplicate keys, NaN, Infinity,
    numbers beyond a double or 64 bits, nesting deeper than 16, lone surrogates and all that is no JSON.
    """
    try:
        text = str(data, "utf-8")
    except UnicodeDecodeError as error:
        raise InvalidInput(f"invalid UTF-8 at byte {error.start}") from None
    if not _is_shallow(data, text):
        _check_depth(text)
    try:
        value = _DECODER.decode(text)
    except json.JSONDecodeError as error:
        raise InvalidInput(f"{error.msg} at character {error.pos}", position=error.pos) from None
    if "\\u" in text:
        _check_surrogates(value)
    return value


def _is_shallow(data: bytes | bytearray | memoryview, text: str) -> bool:
    """Prove that valid JSON is nested no deeper than `DEPTH`, 20 times faster than `_check_depth`.

    One replacement removes the innermost level. False: not proved.
    """
    if "\\" in text:  # an escaped quote would end a string here
        return False
    left = bytes(data).translate(_BRACKETS, _PLAIN).replace(b'""', b"")
    for _ in range(DEPTH):
        left = left.replace(b"[]", b"")
    return not left


def _check_depth(text: str) -> None:
    if text.count("[") + text.count("{") <= DEPTH:
        return
    depth = 0
    for match in _NESTING.finditer(text):
        mark = match[0]
        if mark in ("[", "{"):
            depth += 1
            if depth > DEPTH:
                reason = f"nested deeper than {DEPTH} at character {match.start()}"
                raise InvalidInput(reason, position=match.start())
        elif mark in ("]", "}"):
            depth -= 1


def _check_surrogates(value: Any) -> None:
    try:
        json.dumps(value, ensure_ascii=False).encode("utf-8")
    except UnicodeEncodeError:
        raise InvalidInput("half of a surrogate pair in a string") from None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, object]:
    table = dict(pairs)
    if len(table) != len(pairs):
        seen: set[str] = set()
        for key, _ in pairs:
            if key in seen:
                raise InvalidInput(f"key {key[:40]!r} stands twice in one object")
            seen.add(key)
    return table


def _finite(text: str) -> float:
    number = float(text)
    if not isfinite(number):
        raise InvalidInput(f"{text[:40]} is beyond a double")
    return number


def _int(text: str) -> int:
    number = int(text) if len(text.lstrip("-")) <= _DIGITS else None
    if number is None or not _LEAST <= number <= _MOST:
        raise InvalidInput(f"{text[:40]} is beyond 64 bits")
    return number


def _constant(text: str) -> NoReturn:
    raise InvalidInput(f"{text} is not JSON")


_DECODER = json.JSONDecoder(
    object_pairs_hook=_once, parse_float=_finite, parse_int=_int, parse_constant=_constant
)
