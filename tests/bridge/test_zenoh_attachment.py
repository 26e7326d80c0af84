"""Attachment of a message: the bytes of zenoh-ros2-sdk, and those of Zenoh's own serializer."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.bridge.ros.zenoh.zenoh_attachment import ZenohAttachment, attachment
from twind.exceptions import InvalidInput

numbers = st.integers(0, 2**63 - 1)
gids = st.binary(min_size=16, max_size=16)


@given(numbers, numbers, gids)
def test_the_plain_form_is_the_one_of_the_peer(number: int, time_ns: int, gid: bytes) -> None:
    peers = pytest.importorskip("zenoh_ros2_sdk.attachment", reason="no zenoh-ros2-sdk here (it needs git)")
    data = ZenohAttachment(number, time_ns, gid).pack()
    assert data == peers.Attachment(number, time_ns, gid).to_bytes() and len(data) == 33
    told = peers.Attachment.from_bytes(data)
    assert (told.sequence_id, told.timestamp_ns, told.gid) == (number, time_ns, gid)


@given(numbers, numbers, gids)
def test_it_is_what_the_serializer_of_zenoh_makes_and_comes_back(
    number: int, time_ns: int, gid: bytes
) -> None:
    from zenoh.ext import Int64, z_serialize

    ours = ZenohAttachment(number, time_ns, gid)
    assert ours.pack() == z_serialize((Int64(number), Int64(time_ns), gid)).to_bytes()
    assert attachment(ours.pack()) == ours


@given(st.binary(max_size=100))
def test_other_bytes_are_refused_in_words(data: bytes) -> None:
    plain = len(data) == 33 and data[16] == 16
    if plain:
        assert attachment(data).pack() == data
    else:
        with pytest.raises(InvalidInput, match=f"^{len(data)} bytes are no attachment"):
            attachment(data)
