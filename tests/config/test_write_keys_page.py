"""Rows of a table of keys: cells from the type, the default and the text under the field."""

from typing import Annotated, Any, Literal

import pytest
from msgspec import Meta

from twind.config.config_reader import ConfigStruct, Name
from twind.config.write_keys_page import HEAD, field_notes, key_table, value_text


class InnerKeys(ConfigStruct):
    """A section."""

    p: Annotated[int, Meta(ge=0, le=9)]
    """gain"""
    i: Annotated[int, Meta(ge=0, le=9)]
    """gain"""


class SampleTableKeys(ConfigStruct, kw_only=True):
    """A file."""

    mode: Literal["sim", "live"] = "sim"
    """as `mode` of
    the daemon"""
    inner: InnerKeys
    share: Annotated[float, Meta(gt=0.0, le=0.5)] | None = None
    """ | the model's | what it bears"""
    flag: bool = True


class DerivedTableKeys(SampleTableKeys):
    """A file with a key more."""

    rate: float = 1e6


def test_cells_come_from_the_type_unless_the_text_gives_them() -> None:
    assert key_table(DerivedTableKeys) == "\n".join(
        (
            HEAD,
            "| `rate` |  | 1000000 | |",
            "| `mode` | `sim`, `live` | `sim` | as `mode` of the daemon |",
            "| `inner.p`, `.i` | 0–9 | required | gain |",
            "| `share` | >0, ≤0.5 | the model's | what it bears |",
            "| `flag` | `true`, `false` | `true` | |",
        )
    )


def test_notes_of_a_base_class_are_those_of_the_derived_one() -> None:
    assert field_notes(DerivedTableKeys)["share"] == "| the model's | what it bears"
    assert field_notes(DerivedTableKeys)["rate"] == ""


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        (Annotated[float, Meta(gt=0.0)], ">0"),
        (Annotated[float, Meta(ge=0.5)], "≥0.5"),
        (Annotated[int, Meta(ge=256, le=2**24)] | None, "256–16777216"),
        (Literal[1, -1], "1, -1"),
        (bool, "`true`, `false`"),
        (Name | None, "1–64 of a-z, 0-9, `_`, `-`"),
        (float, ""),
    ],
)
def test_values_are_written_as_the_bounds_of_the_type(kind: Any, text: str) -> None:
    assert value_text(kind) == text
