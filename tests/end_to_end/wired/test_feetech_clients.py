"""Clients that others wrote, unmodified, against virtual Feetech servos on a pseudo-terminal.

feetech-servo-sdk 1.0.0 and rustypot 1.13. Their own faults that a test must step around stand beside it as
`CLIENT:`.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.bench_servos import bench_servos
from tests.support.processes import until

BAUD = 1_000_000
STS = (1, 2, 3, 4, 5, 6)
SCS = 20

sdk = pytest.importorskip("scservo_sdk")
rustypot = pytest.importorskip("rustypot")


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The port of a running `twind-virtual` with six STS3215 and an SCS0009."""
    folder = tmp_path_factory.mktemp("clients")
    servos = [f"main:{id}:STS3215:3.10" for id in STS] + [f"main:{SCS}:SCS0009"]
    with bench_servos(folder, BAUD, servos) as port:
        yield port


@pytest.fixture
def port(line: Path) -> Iterator[object]:
    handler = sdk.PortHandler(str(line))
    assert handler.openPort()
    assert handler.setBaudRate(BAUD)
    yield handler
    handler.closePort()


def answered(what):
    """CLIENT: it waits 34 ms by the wall clock, which a loaded machine may need for itself: up to 3 times."""
    for _ in range(3):
        answer = what()
        if sdk.COMM_RX_TIMEOUT not in answer:
            break
    return answer


def test_the_vendors_sdk_finds_reads_and_writes(port) -> None:
    talk = sdk.PacketHandler(0)
    assert answered(lambda: talk.ping(port, 1)) == (777, 0, 0)
    assert talk.ping(port, 99)[1] == sdk.COMM_RX_TIMEOUT
    assert answered(lambda: talk.write1ByteTxRx(port, 1, 41, 50)) == (0, 0)
    assert answered(lambda: talk.read1ByteTxRx(port, 1, 41)) == (50, 0, 0)
    assert answered(lambda: talk.read2ByteTxRx(port, 1, 11)) == (4095, 0, 0)


def test_the_vendors_sdk_moves_a_servo_by_sync_write_and_sync_read(port) -> None:
    talk = sdk.PacketHandler(0)
    ids = STS[:3]
    for id in ids:
        assert answered(lambda id=id: talk.write1ByteTxRx(port, id, 40, 1)) == (0, 0)
    write = sdk.GroupSyncWrite(port, talk, 42, 2)
    for id in ids:
        assert write.addParam(id, list((2000 + id).to_bytes(2, "little")))
    assert write.txPacket() == sdk.COMM_SUCCESS
    read = sdk.GroupSyncRead(port, talk, 56, 2)
    for id in ids:
        assert read.addParam(id)

    def arrived() -> bool:
        if read.txRxPacket() != sdk.COMM_SUCCESS:
            return False
        return all(abs(read.getData(id, 56, 2) - 2000 - id) <= 1 for id in ids)

    until(arrived, 5.0, "the servos do not arrive")
    for id in ids:
        answered(lambda id=id: talk.write1ByteTxRx(port, id, 40, 0))


def test_the_vendors_sdk_speaks_to_an_scs_in_its_byte_order(port) -> None:
    """CLIENT: the byte order is a module global, so the handler of another family is made after use."""
    talk = sdk.PacketHandler(1)
    assert answered(lambda: talk.read2ByteTxRx(port, SCS, 11)) == (1023, 0, 0)
    position, result, error = answered(lambda: talk.read2ByteTxRx(port, SCS, 56))
    assert (result, error) == (0, 0)
    assert 300 <= position <= 720
    sdk.PacketHandler(0)


def test_rustypot_reads_and_moves(line: Path) -> None:
    """CLIENT: negative positions are wrong by name (two's complement), so these are positive."""
    io = rustypot.Sts3215PyController(str(line), BAUD, 0.2)
    assert io.ping(4)
    ids = [4, 5, 6]
    goals = [0.1, 0.2, 0.3]
    io.sync_write_torque_enable(ids, [True] * 3)
    io.sync_write_goal_position(ids, goals)
    until(
        lambda: io.sync_read_present_position(ids) == pytest.approx(goals, abs=0.004),
        5.0,
        "they do not arrive",
    )
    io.sync_write_torque_enable(ids, [False] * 3)
    io.close()


def test_rustypot_reads_an_scs(line: Path) -> None:
    io = rustypot.Scs0009PyController(str(line), BAUD, 0.2)
    assert io.ping(SCS)
    (angle,) = io.read_present_position(SCS)
    io.close()
    assert abs(angle) < 1.1
