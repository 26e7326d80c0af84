"""Annotations of `Mark`: their kinds and fields. Front process; pure."""

from collections.abc import Mapping
from typing import Any

from twind.exceptions import InvalidInput
from twind.link import Annotation

KINDS = {"begin": ("task", "text"), "end": ("task", "success", "text"), "note": ("text",)}  # what each has
NEEDED = {"begin": "task", "note": "text"}
LONGEST = {"task": 100, "text": 500}  # characters


def annotation(given: Mapping[str, Any]) -> Annotation:
    """Annotation from the parameters of a call, whose `kind` is a key of KINDS. Raises InvalidInput."""
    kind = given["kind"]
    fields = {key: given[key] for key in ("task", "success", "text") if given.get(key) is not None}
    for key in fields:
        if key not in KINDS[kind]:
            raise InvalidInput(f"{kind} has none; it takes {' and '.join(KINDS[kind])}", where=key)
    if kind in NEEDED and NEEDED[kind] not in fields:
        raise InvalidInput(f"is missing: {kind} needs it", where=NEEDED[kind])
    for key, most in LONGEST.items():
        text = fields.get(key, "-")
        if not text.strip() or len(text) > most or not text.isprintable():
            reason = f"expected 1 to {most} printable characters on one line, got {len(text)}"
            raise InvalidInput(f"{reason}{'' if text.isprintable() else ', some not printable'}", where=key)
    return Annotation(kind, **fields)
