"""Annotations of `Mark`: their kinds and fields. Front process; pure."""

from collections.abc import Mapping
from typing import Any

from twind.link import Annotation
from twind.protocol import WrongParameter

KINDS = {"begin": ("task", "text"), "end": ("task", "success", "text"), "note": ("text",)}  # what each has
NEEDED = {"begin": "task", "note": "text"}
LONGEST = {"task": 100, "text": 500}  # characters


def annotation(given: Mapping[str, Any]) -> Annotation:
    """Check the parameters of a call, whose `kind` is a key of KINDS. Raises WrongParameter."""
    kind = given["kind"]
    fields = {key: given[key] for key in ("task", "success", "text") if given.get(key) is not None}
    for key in fields:
        if key not in KINDS[kind]:
            raise WrongParameter(key, f"{kind} has none; it takes {' and '.join(KINDS[kind])}")
    if kind in NEEDED and NEEDED[kind] not in fields:
        raise WrongParameter(NEEDED[kind], f"is missing: {kind} needs it")
    for key, most in LONGEST.items():
        text = fields.get(key, "-")
        if not text.strip() or len(text) > most or not text.isprintable():
            reason = f"expected 1 to {most} printable characters on one line, got {len(text)}"
            raise WrongParameter(key, f"{reason}{'' if text.isprintable() else ', some not printable'}")
    return Annotation(kind, **fields)
