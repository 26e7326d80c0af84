"""Clients that others wrote, unmodified, against virtual servos on a pseudo-terminal: all that they can say.

dynamixel-sdk 4.1.0 and rustypot. The SDK's own faults (measured on 4.1.0) that a test must step around stand
beside it as `SDK:`. Two clients that agree with the servos prove the bytes; the rules have their own tests.
"""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import dynamixel_sdk as sdk
import pytest

from tests.support.bench_servos import bench_servos
from tests.support.processes import until
from twind_drivers.dynamixel.packet import Instruction

BAUD = 2_000_000
XM, XL, PH = (
    (11, 12, 13),
    21,
    31,
)  # SDK: fast bulk read looks ids up among addresses and lengths: no such byte
SPARE = {
    "reset": 41,
    "reboot": 42,
    "clear": 43,
    "backup": 44,
    "id": 45,
    "rusty reset": 46,
    "rusty reboot": 47,
}
BOOT = 0.2  # s


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The port of a running `twind-virtual` with servos of three layouts on one bus."""
    folder = tmp_path_factory.mktemp("clients")
    servos = [f"main:{id}:XM430-W350:47" for id in (*XM, *SPARE.values())]
    servos += [f"main:{XL}:XL330-M288:52", f"main:{PH}:PH54-100-S500:12"]
    with bench_servos(folder, BAUD, servos, "--return-delay", "0") as port:
        yield port


# ---------------------------------------------------------------------- dynamixel-sdk


@pytest.fixture
def port(line: Path) -> Iterator[sdk.PortHandler]:
    handler = sdk.PortHandler(str(line))
    assert handler.openPort()
    assert handler.setBaudRate(BAUD)
    yield handler
    handler.closePort()


talk = sdk.PacketHandler(2.0)


def ask(what: Callable[[], tuple]) -> tuple:
    """SDK: it waits 34 ms by the wall clock, which a loaded machine may need for itself: up to 3 times."""
    for _ in range(3):
        answer = what()
        if sdk.COMM_RX_TIMEOUT not in answer:
            break
    return answer


def test_sdk_ping_one_and_all(port: sdk.PortHandler) -> None:
    assert ask(lambda: talk.ping(port, XM[0])) == (1020, 0, 0)
    assert ask(lambda: talk.ping(port, PH)) == (2010, 0, 0)
    assert talk.ping(port, 99)[1] == sdk.COMM_RX_TIMEOUT
    found, result = talk.broadcastPing(port)  # SDK: always waits its whole window, 0.8 s
    assert result == sdk.COMM_SUCCESS
    assert found[XM[0]] == [1020, 47]
    assert found[XL] == [1200, 52]
    assert found[PH] == [2010, 12]
    assert set(found) == {*XM, XL, PH, *SPARE.values()}
    assert list(found) == sorted(found)


def test_sdk_reads_and_writes_of_1_2_and_4_bytes(port: sdk.PortHandler) -> None:
    """SDK: what it sends is never stuffed, so no value here holds FF FF FD."""
    for address, value, write, read in (
        (65, 1, talk.write1ByteTxRx, talk.read1ByteTxRx),
        (84, 1234, talk.write2ByteTxRx, talk.read2ByteTxRx),
        (116, 3210, talk.write4ByteTxRx, talk.read4ByteTxRx),
    ):
        assert ask(lambda write=write, at=address, v=value: write(port, XM[0], at, v)) == (0, 0)
        assert ask(lambda read=read, at=address: read(port, XM[0], at)) == (value, 0, 0)
    assert ask(lambda: talk.writeTxRx(port, PH, 564, 4, [5, 0, 0, 0])) == (0, 0)
    data, result, error = ask(lambda: talk.readTxRx(port, PH, 564, 4))
    assert (list(data), result, error) == ([5, 0, 0, 0], 0, 0)


def test_sdk_sees_each_error_number(port: sdk.PortHandler) -> None:
    """e-manual "Protocol 2.0", Error: 2, 4, 5, 6, 7; an error 3 the SDK cannot provoke."""
    id = XM[1]
    assert ask(lambda: talk.write1ByteTxRx(port, id, 64, 2)) == (0, 4)
    assert ask(lambda: talk.write2ByteTxRx(port, id, 116, 2)) == (0, 5)
    assert ask(lambda: talk.write4ByteTxRx(port, id, 116, 4096)) == (0, 6)
    assert ask(lambda: talk.write4ByteTxRx(port, id, 132, 1)) == (0, 7)
    unknown = [0, 0, 0, 0, id, 3, 0, 0x77, 0, 0]
    assert ask(lambda: talk.txRxPacket(port, list(unknown))[1:]) == (0, 2)


def test_sdk_reg_write_and_action(port: sdk.PortHandler) -> None:
    id = XM[0]
    assert ask(lambda: talk.regWriteTxRx(port, id, 116, 4, [200, 0, 0, 0])) == (0, 0)
    assert ask(lambda: talk.read1ByteTxRx(port, id, 69)) == (1, 0, 0)
    assert talk.action(port, id) == 0
    time.sleep(0.05)  # SDK: action does not wait for its status, the next call would take it for its own
    assert ask(lambda: talk.read1ByteTxRx(port, id, 69)) == (0, 0, 0)
    assert ask(lambda: talk.read4ByteTxRx(port, id, 116)) == (200, 0, 0)


def test_sdk_reboot(port: sdk.PortHandler) -> None:
    id = SPARE["reboot"]
    assert ask(lambda: talk.write2ByteTxRx(port, id, 84, 99)) == (0, 0)
    assert talk.reboot(port, id) == (0, 0)
    time.sleep(BOOT)
    assert ask(lambda: talk.read2ByteTxRx(port, id, 84)) == (800, 0, 0)


def test_sdk_factory_reset(port: sdk.PortHandler) -> None:
    """With option 2, so that it stays on this line."""
    id = SPARE["reset"]
    assert ask(lambda: talk.write4ByteTxRx(port, id, 20, 321)) == (0, 0)
    assert talk.factoryReset(port, id, 0x02) == (0, 0)
    time.sleep(BOOT)
    assert ask(lambda: talk.read4ByteTxRx(port, id, 20)) == (0, 0, 0)
    assert ask(lambda: talk.read1ByteTxRx(port, id, 9)) == (250, 0, 0)


def test_sdk_clear_multi_turn(port: sdk.PortHandler) -> None:
    id = SPARE["clear"]
    assert ask(lambda: talk.write1ByteTxRx(port, id, 11, 4)) == (0, 0)
    assert ask(lambda: talk.write1ByteTxRx(port, id, 64, 1)) == (0, 0)
    assert ask(lambda: talk.write4ByteTxRx(port, id, 116, 5000)) == (0, 0)
    time.sleep(0.1)
    assert talk.clearMultiTurn(port, id) == (0, 1), "it moves"
    until(lambda: abs(talk.read4ByteTxRx(port, id, 132)[0] - 5000) <= 2, 10.0, "the servo at its goal")
    until(lambda: talk.read1ByteTxRx(port, id, 122) == (0, 0, 0), 10.0, "the servo at rest")  # Moving
    assert ask(lambda: talk.write1ByteTxRx(port, id, 64, 0)) == (0, 0)
    assert talk.clearMultiTurn(port, id) == (0, 0)
    assert ask(lambda: talk.read4ByteTxRx(port, id, 132))[0] == pytest.approx(5000 - 4096, abs=2)


def test_sdk_carries_a_backup_that_it_has_no_call_for(port: sdk.PortHandler) -> None:
    id = SPARE["backup"]

    def backup(what: int) -> tuple:
        order = [0, 0, 0, 0, id, 8, 0, int(Instruction.BACKUP), what, 0x43, 0x54, 0x52, 0x4C, 0, 0]
        return talk.txRxPacket(port, order)[1:]

    assert ask(lambda: talk.write4ByteTxRx(port, id, 20, 55)) == (0, 0)
    assert ask(lambda: backup(1)) == (0, 0)
    assert ask(lambda: talk.read1ByteTxRx(port, id, 147)) == (1, 0, 0)
    assert ask(lambda: talk.write4ByteTxRx(port, id, 20, 66)) == (0, 0)
    assert backup(2) == (0, 0)
    time.sleep(BOOT)
    assert ask(lambda: talk.read4ByteTxRx(port, id, 20)) == (55, 0, 0)


def test_sdk_sync_write_sync_read_and_fast_sync_read(port: sdk.PortHandler) -> None:
    """SDK: group reads drop the error bytes; one absent servo costs all of them, so none is asked."""
    goals = sdk.GroupSyncWrite(port, talk, 116, 4)
    for place, id in enumerate(XM):
        assert goals.addParam(id, list((1000 + place).to_bytes(4, "little")))
    assert goals.txPacket() == 0
    group = sdk.GroupSyncRead(port, talk, 116, 4)
    for id in XM:
        assert group.addParam(id)
    for read in (group.txRxPacket, group.fastSyncRead):
        assert ask(lambda read=read: (read(),)) == (0,)
        assert [group.getData(id, 116, 4) for id in XM] == [1000, 1001, 1002]


def test_sdk_bulk_write_bulk_read_and_fast_bulk_read_over_three_layouts(port: sdk.PortHandler) -> None:
    rows = {XM[0]: (116, 4, 1500), XM[1]: (84, 2, 700), XL: (65, 1, 1), PH: (564, 4, 70_000)}
    writes = sdk.GroupBulkWrite(port, talk)
    reads = sdk.GroupBulkRead(port, talk)
    for id, (address, size, value) in rows.items():
        assert writes.addParam(id, address, size, list(value.to_bytes(size, "little")))
        assert reads.addParam(id, address, size)
    assert writes.txPacket() == 0
    for read in (reads.txRxPacket, reads.fastBulkRead):
        assert ask(lambda read=read: (read(),)) == (0,)
        for id, (address, size, value) in rows.items():
            assert reads.getData(id, address, size) == value


def test_sdk_reads_through_indirect_registers_of_three_layouts(port: sdk.PortHandler) -> None:
    for id, data, position in ((XM[2], 224, 132), (XL, 208, 132), (PH, 634, 580)):
        for place in range(4):
            answer = ask(lambda i=id, k=place, p=position: talk.write2ByteTxRx(port, i, 168 + 2 * k, p + k))
            assert answer == (0, 0)
        straight = ask(lambda i=id, p=position: talk.read4ByteTxRx(port, i, p))
        assert ask(lambda i=id, d=data: talk.read4ByteTxRx(port, i, d)) == straight
        assert 1648 <= straight[0] <= 2448
        assert straight[1:] == (0, 0)


def test_sdk_changes_an_id(port: sdk.PortHandler) -> None:
    """The answer comes under the old id, the one that the SDK waits for."""
    id = SPARE["id"]
    assert talk.write1ByteTxRx(port, id, 7, 150) == (0, 0)
    assert ask(lambda: talk.ping(port, 150)) == (1020, 0, 0)
    assert talk.write1ByteTxRx(port, 150, 7, id) == (0, 0)


# ---------------------------------------------------------------------- rustypot


@pytest.fixture
def rusty(line: Path) -> Iterator[object]:
    rustypot = pytest.importorskip("rustypot")
    io = rustypot.Xl430PyController(str(line), BAUD, 0.2)
    yield io
    io.close()


def test_rustypot_finds_them(rusty) -> None:
    assert rusty.ping(XM[0])
    assert not rusty.ping(99)
    assert rusty.scan([XM[0], XL, PH, 99]) == {XM[0]: 1020, XL: 1200, PH: 2010}
    assert rusty.broadcast_scan([*XM, PH]) == {**dict.fromkeys(XM, 1020), PH: 2010}


@pytest.mark.parametrize("value", [1234, -131073, 0xFDFFFF, -3])
def test_rustypot_reads_and_writes_also_what_must_be_stuffed(rusty, value: int) -> None:
    """-131073 is FF FF FD FF, 0xFDFFFF FF FF FD 00: stuffed both ways. New indirect data is plain memory."""
    raw = list(value.to_bytes(4, "little", signed=True))
    assert rusty.write_raw_data_with_error(XM[0], 240, raw) == 0
    assert list(rusty.read_raw_data(XM[0], 240, 4)) == raw
    rusty.write_raw_data(XM[0], 240, raw)
    data, error = rusty.read_raw_data_with_error(XM[0], 240, 4)
    assert (list(data), error) == (raw, 0)


def test_rustypot_sees_error_numbers(rusty) -> None:
    assert rusty.write_raw_data_with_error(XM[1], 132, [0, 0, 0, 0]) == 7
    assert rusty.write_raw_data_with_error(XM[1], 64, [2]) == 4
    assert rusty.read_raw_data_with_error(XM[1], 71, 1)[1] == 7


@pytest.mark.parametrize("fast", [False, True])
def test_rustypot_sync_write_and_sync_read(rusty, fast: bool) -> None:
    rows = [list((-131073 - 256 * place).to_bytes(4, "little", signed=True)) for place in range(3)]
    rusty.sync_write_raw_data(list(XM), 244, rows)
    rusty.set_fast_sync_read(fast)
    assert [list(row) for row in rusty.sync_read_raw_data(list(XM), 244, 4)] == rows
    found = rusty.sync_read_raw_data_with_error(list(XM), 244, 4)
    assert [(list(row), error) for row, error in found] == [(row, 0) for row in rows]


def test_rustypot_reboots_and_resets(rusty) -> None:
    id = SPARE["rusty reboot"]
    rusty.write_raw_data(id, 84, [99, 0])
    assert rusty.reboot(id)
    time.sleep(BOOT)
    assert list(rusty.read_raw_data(id, 84, 2)) == [0x20, 0x03]
    id = SPARE["rusty reset"]
    rusty.write_raw_data(id, 20, [65, 1, 0, 0])
    rusty.factory_reset(id, False, True)
    time.sleep(BOOT)
    assert list(rusty.read_raw_data(id, 20, 4)) == [0, 0, 0, 0]


def test_rustypot_bus_drives_two_models_at_once(line: Path) -> None:
    rustypot = pytest.importorskip("rustypot")
    motors = {
        XM[0]: rustypot.Xl430PyController.definition(),
        XL: rustypot.Xl330PyController.definition(),
    }
    with rustypot.Bus(str(line), BAUD, 0.2, motors) as bus:
        bus.sync_write_register([XM[0], XL], "goal_position", [1111, 2222])
        assert list(bus.sync_read_register([XM[0], XL], "goal_position")) == [1111, 2222]
