"""A sealed memfd cannot change, and one that could change is not read."""

import fcntl
import mmap
import os
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind import sealed_memfd


@pytest.fixture
def sealed() -> Iterator[int]:
    fd = sealed_memfd.seal("test", b"the robot")
    yield fd
    os.close(fd)


@examples(20)
@given(st.binary(max_size=100_000))
def test_sealed_data_is_read_back_unchanged(data: bytes) -> None:
    fd = sealed_memfd.seal("test", data)
    try:
        assert sealed_memfd.unseal(fd) == data
        assert sealed_memfd.unseal(fd) == data  # reading takes nothing away
    finally:
        os.close(fd)


def test_a_sealed_memfd_cannot_be_changed_in_any_way(sealed: int) -> None:
    with pytest.raises(PermissionError):
        os.pwrite(sealed, b"X", 0)
    with pytest.raises(PermissionError):
        os.ftruncate(sealed, 1)
    with pytest.raises(PermissionError):
        os.ftruncate(sealed, 100)
    with pytest.raises(PermissionError):
        mmap.mmap(sealed, 9)
    with pytest.raises(PermissionError):
        fcntl.fcntl(sealed, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SEAL)
    again = os.open(f"/proc/self/fd/{sealed}", os.O_RDWR)
    with pytest.raises(PermissionError):
        os.write(again, b"X")
    os.close(again)
    assert sealed_memfd.unseal(sealed) == b"the robot"


def test_a_sealed_memfd_is_not_inherited(sealed: int) -> None:
    assert not os.get_inheritable(sealed)


@pytest.mark.parametrize(
    "missing",
    [fcntl.F_SEAL_SHRINK, fcntl.F_SEAL_GROW, fcntl.F_SEAL_WRITE, fcntl.F_SEAL_SEAL, sealed_memfd.SEALS],
)
def test_a_memfd_that_could_still_change_is_not_read(missing: int) -> None:
    fd = os.memfd_create("test", os.MFD_ALLOW_SEALING)
    try:
        os.write(fd, b"the robot")
        fcntl.fcntl(fd, fcntl.F_ADD_SEALS, sealed_memfd.SEALS & ~missing)
        with pytest.raises(ValueError, match="not sealed"):
            sealed_memfd.unseal(fd)
    finally:
        os.close(fd)


def test_a_file_that_is_no_memfd_is_refused() -> None:
    with open(__file__, "rb") as file, pytest.raises(OSError):
        sealed_memfd.unseal(file.fileno())


def test_more_than_is_taken_is_not_read(sealed: int) -> None:
    assert sealed_memfd.unseal(sealed, most=9) == b"the robot"
    with pytest.raises(ValueError, match="holds 9 bytes, at most 8 are taken"):
        sealed_memfd.unseal(sealed, most=8)
