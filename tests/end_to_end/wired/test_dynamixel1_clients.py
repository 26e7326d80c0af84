"""Clients that others wrote, unmodified, against virtual servos of Protocol 1.0 on a pseudo-terminal.

dynamixel-sdk 4.1 and rustypot 1.13. Faults of theirs that a test must step around stand beside it: `CLIENT:`.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.bench_servos import bench_servos
from tests.support.processes import until

BAUD = 1_000_000
MX = (1, 2, 3)
AX = (11, 12)

sdk = pytest.importorskip("dynamixel_sdk")
rustypot = pytest.importorskip("rustypot")


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The port of a running `twind-virtual` with three MX-28 and two AX-12A."""
    folder = tmp_path_factory.mktemp("clients")
    servos = [f"main:{id}:MX-28(1.0):36" for id in MX] + [f"main:{id}:AX-12A" for id in AX]
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
    talk = sdk.PacketHandler(1.0)
    assert answered(lambda: talk.ping(port, 1)) == (29, 0, 0)
    assert answered(lambda: talk.ping(port, AX[0])) == (12, 0, 0)
    assert talk.ping(port, 99)[1] == sdk.COMM_RX_TIMEOUT
    assert answered(lambda: talk.write1ByteTxRx(port, 1, 28, 40)) == (0, 0)
    assert answered(lambda: talk.read1ByteTxRx(port, 1, 28)) == (40, 0, 0)
    assert answered(lambda: talk.read2ByteTxRx(port, AX[0], 8)) == (1023, 0, 0)
    assert answered(lambda: talk.write2ByteTxRx(port, 1, 30, 4096))[1] == 0x08, "out of range"


def test_the_vendors_sdk_moves_servos_by_sync_write(port) -> None:
    """CLIENT: its bulk read of Protocol 1.0 raises TypeError, so positions are read one by one."""
    talk = sdk.PacketHandler(1.0)
    write = sdk.GroupSyncWrite(port, talk, 30, 2)
    for id in MX:
        assert answered(lambda id=id: talk.write1ByteTxRx(port, id, 24, 1)) == (0, 0)
        assert write.addParam(id, list((2000 + id).to_bytes(2, "little")))
    assert write.txPacket() == sdk.COMM_SUCCESS
    until(
        lambda: all(
            abs(answered(lambda id=id: talk.read2ByteTxRx(port, id, 36))[0] - 2000 - id) <= 1 for id in MX
        ),
        5.0,
        "the servos do not arrive",
    )
    for id in MX:
        answered(lambda id=id: talk.write1ByteTxRx(port, id, 24, 0))


@pytest.mark.parametrize(("name", "id"), [("MxPyController", MX[0]), ("AxPyController", AX[0])])
def test_rustypot_reads_and_moves(line: Path, name: str, id: int) -> None:
    """CLIENT: its group reads send an instruction that Protocol 1.0 has not; only single calls are usable."""
    io = getattr(rustypot, name)(str(line), BAUD, 0.2) if hasattr(rustypot, name) else None
    if io is None:
        io = getattr(rustypot.servo, name)(str(line), BAUD, 0.2)
    assert io.ping(id)
    io.write_torque_enable(id, True)
    io.write_goal_position(id, 0.2)
    until(lambda: io.read_present_position(id)[0] == pytest.approx(0.2, abs=0.006), 5.0, "it does not arrive")
    io.write_torque_enable(id, False)
    io.close()
