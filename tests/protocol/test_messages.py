"""The typed messages against the IDL of the interface."""

from __future__ import annotations

from typing import get_args, get_type_hints, is_typeddict

import pytest

from twind.protocol import CONTROL, load, messages
from twind.protocol.idl import OptionalType, StructType

MESSAGES = {
    name.removesuffix("Message"): value for name, value in vars(messages).items() if is_typeddict(value)
}


@pytest.mark.parametrize("name", MESSAGES)
def test_a_typed_message_has_the_fields_of_the_idl_and_none_where_they_may_be_absent(name: str) -> None:
    declared = load(CONTROL).types[name]
    assert isinstance(declared, StructType)
    hints = get_type_hints(MESSAGES[name])
    optional = {key for key, kind in hints.items() if type(None) in get_args(kind)}
    assert hints.keys() == declared.fields.keys()
    assert optional == {key for key, kind in declared.fields.items() if isinstance(kind, OptionalType)}
