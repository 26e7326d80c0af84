"""YAML as nobody should write it: a valid text, changed line by line, damaged, or replaced."""

import time
from collections.abc import Callable
from random import Random

from tests.proof.fuzz.mangle import mangled
from twind.config.yaml_tree import ConfigError

LONGEST = 2.0  # s of CPU for one text

VALUES = (
    *(".nan", "-.inf", "1e3", "1e999", "010", "0x10", "12:30", "no", "~", "''", "'1'", "2026-01-01", "1_000"),
    *("-1", "0", "99999999999999999999", "!!python/object/apply:os.system [ls]", "!!binary aGk=", "!x 1"),
    *(
        "&a 1",
        "*a",
        "<<: *a",
        "[1, 2",
        "{a: b",
        "{a: 1, a: 2}",
        "[]",
        "{}",
        "'\\ud800'",
        '"\\ud800"',
        "|\n  x",
    ),
    *("\t", "%YAML 2.0", "--- a", "... b", "\x00", "é", "\ufeff", "a: b: c", "? x", "- - -", "[[[[1]]]]"),
)
BOMBS = (
    "a: &a [x, x]\nb: &b [*a, *a]\nc: &c [*b, *b]\n",
    "[" * 3000,
    "{a: " * 2000,
    "- " * 2000,
    "a:\n" + "".join(" " * depth + "b:\n" for depth in range(1, 1500)),
    "k: v\n" * 20_000,
    "x" * 300_000,
    "'" + "y" * 200_000,
    "? " * 1000,
    "&a [*a]",
    "--- 1\n--- 2\n",
)


def mutated_yaml(rng: Random, text: str) -> bytes:
    """`text` with some lines changed, or something else altogether."""
    kind = rng.randrange(10)
    if kind == 0:
        return rng.randbytes(rng.randrange(400))
    if kind == 1:
        return (text[: rng.randrange(len(text))] + rng.choice(BOMBS)).encode()
    if kind <= 3:
        return mangled(rng, text.encode(), rng.randrange(1, 8))
    lines = text.split("\n")
    for _ in range(rng.choice((1, 1, 2, 6))):
        _change(rng, lines)
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def _change(rng: Random, lines: list[str]) -> None:
    """One line of YAML, changed as a person or a program might change it."""
    at = rng.randrange(len(lines))
    key, colon, value = lines[at].partition(":")
    kind = rng.randrange(8)
    if kind <= 2 and colon:
        lines[at] = f"{key}: {rng.choice(VALUES)}"
    elif kind == 3 and value:  # one of the numbers or words in it
        words = value.split(" ")
        words[rng.randrange(len(words))] = rng.choice(VALUES)
        lines[at] = f"{key}:{' '.join(words)}"
    elif kind == 4:
        lines.insert(at, lines[at])
    elif kind == 5:
        del lines[at]
        lines.append("")
    elif kind == 6:
        other = rng.randrange(len(lines))
        lines[at], lines[other] = lines[other], lines[at]
    else:
        lines[at] = " " * rng.randrange(5) + lines[at] + rng.choice(("", " #", "\t", "  x"))


def is_accepted(read: Callable[[], object], size: int) -> bool:
    """Check whether `read` accepts a text of `size` bytes. A refusal is a ConfigError with a reason."""
    begun = time.process_time()
    refused = None
    try:
        read()
    except ConfigError as error:
        refused = str(error)
    assert refused != "", "refused without a word"
    took = time.process_time() - begun
    assert took < LONGEST, f"{took:.1f} s for {size} bytes"
    return refused is None
