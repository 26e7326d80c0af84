"""The real `twind-virtual` on real pseudo-terminals, driven by the vendor's own client."""

import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import dynamixel_sdk as sdk
import pytest
import serial

from tests.support.processes import until
from twind.config.calibration_file import load_calibration
from twind.config.robot_file import load_robot
from twind.virtual.virtual_main import main

IDS = list(range(1, 25))


class Virtual:
    """A running process, what it said, and its faults socket."""

    def __init__(self, folder: Path, *options: str) -> None:
        self.folder = folder
        command = [sys.executable, "-m", "twind.virtual", "--link", str(folder), "--muscles", "first-order"]
        command += ["--faults", str(folder / "faults"), *options]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.said = list(self._lines())

    def _lines(self) -> Iterator[str]:
        assert self.process.stdout is not None
        while (line := self.process.stdout.readline().decode().strip()) not in ("", "ready"):
            yield line

    def order(self, **order: object) -> dict:
        with socket.socket(socket.AF_UNIX) as client:
            client.settimeout(5.0)
            client.connect(str(self.folder / "faults"))
            client.sendall(json.dumps(order).encode() + b"\n")
            return json.loads(client.makefile().readline())

    def servos(self) -> list[dict]:
        return self.order(query="state")["buses"]["main"]["servos"]


@contextmanager
def virtual(folder: Path, *options: str) -> Iterator[Virtual]:
    with bench(folder, "--calibration", str(folder / "fits.yaml"), *options) as running:
        yield running


@contextmanager
def bench(folder: Path, *options: str) -> Iterator[Virtual]:
    running = Virtual(folder, *options)
    try:
        yield running
    finally:
        assert running.process.stdin is not None
        running.process.stdin.close()
        assert running.process.wait(5.0) == 0, "ends at end-of-file on its input"
        assert running.process.stdout is not None
        running.process.stdout.close()
        assert not (folder / "main").is_symlink()


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Virtual]:
    with virtual(tmp_path_factory.mktemp("virtual")) as running:
        yield running


@contextmanager
def client(path: Path, baud: int = 2_000_000) -> Iterator[sdk.PortHandler]:
    port = sdk.PortHandler(str(path))
    assert port.openPort()
    assert port.setBaudRate(baud)
    try:
        yield port
    finally:
        port.closePort()


def await_ping(port: sdk.PortHandler, id: int = 1) -> None:
    """Wait until an XM430 replies. The SDK waits 34 ms of wall-clock time, which a busy machine may need."""
    talk = sdk.PacketHandler(2.0)
    until(lambda: talk.ping(port, id) == (1020, 0, 0), 3.0, f"a reply of id {id}")


def test_the_port_of_a_servo_at_another_baud_is_silent(tmp_path: Path) -> None:
    with virtual(tmp_path, "--baud", "1000000", "--no-wire-timing"):
        talk = sdk.PacketHandler(2.0)
        with client(tmp_path / "main") as port:
            assert talk.ping(port, 1)[1] == sdk.COMM_RX_TIMEOUT
        with client(tmp_path / "main", 1_000_000) as port:
            await_ping(port)


def test_unplug_hangs_up_and_replug_is_found_under_the_same_name(shared: Virtual) -> None:
    port = serial.Serial(str(shared.folder / "main"), 2_000_000)
    poll = select.poll()
    poll.register(port.fileno(), select.POLLIN)
    assert shared.order(fault="unplug")["ok"]
    assert poll.poll(500)[0][1] & select.POLLHUP
    with pytest.raises(OSError, match="Input/output"):
        os.write(port.fileno(), b"x")
    port.close()
    assert not (shared.folder / "main").exists()
    assert shared.order(fault="replug")["ok"]
    with client(shared.folder / "main") as again:
        await_ping(again)


def test_single_servos_are_served_without_a_robot_file_including_duplicate_ids(tmp_path: Path) -> None:
    twins = [
        "--servo",
        "main:5:XM430-W350",
        "--servo",
        "main:5:XM430-W350",
        "--servo",
        "main:9:XL330-M288:46",
    ]
    with (
        bench(tmp_path, *twins, "--baud", "1000000") as running,
        client(tmp_path / "main", 1_000_000) as port,
    ):
        talk = sdk.PacketHandler(2.0)
        assert talk.ping(port, 9) == (1200, 0, 0)
        assert talk.read1ByteTxRx(port, 9, 6) == (46, 0, 0)
        assert talk.read2ByteTxRx(port, 5, 0) == (1020, 0, 0), "twins that say the same are heard as one"
        assert running.order(fault="heat", id=5, celsius=40)["ok"]
        assert "ids are [5, 5, 9]" in running.order(fault="drop", count=1, id=3)["error"]


def test_a_stalled_adapter_keeps_its_bytes_and_an_adapter_with_noise_stalls_no_client(
    shared: Virtual,
) -> None:
    with client(shared.folder / "main") as port:
        talk = sdk.PacketHandler(2.0)
        assert shared.order(fault="stall")["ok"]
        assert talk.ping(port, 1)[1] == sdk.COMM_RX_TIMEOUT
        assert shared.order(fault="stall", on=False)["ok"]
        time.sleep(0.1)
        port.clearPort()
        await_ping(port)
        assert shared.order(fault="babble")["ok"]
        time.sleep(0.3)  # nobody reads what it says: the output fills up
        asked = time.monotonic()
        assert shared.order(query="state")["ok"]
        assert time.monotonic() - asked < 0.5
        assert shared.order(fault="clear")["ok"]
        time.sleep(0.1)
        port.clearPort()
        await_ping(port)


def test_unplugged_and_back_under_another_name_the_link_leads_there(shared: Virtual) -> None:
    before = os.path.realpath(shared.folder / "main")
    assert shared.order(fault="unplug")["ok"]
    answer = shared.order(fault="replug", renamed=True)
    assert answer["path"] == os.path.realpath(shared.folder / "main") != before
    with client(shared.folder / "main") as port:
        await_ping(port)


def test_a_second_one_on_the_same_link_is_refused_and_the_first_serves_on(
    shared: Virtual, capsys: pytest.CaptureFixture[str]
) -> None:
    before = os.readlink(shared.folder / "main")
    for faults in ([], ["--faults", str(shared.folder / "faults")]):
        assert main(["--link", str(shared.folder), "--muscles", "first-order", *faults]) == 2
        assert f"{shared.folder / 'main'}: another twind-virtual serves it" in capsys.readouterr().err
    assert os.readlink(shared.folder / "main") == before
    with client(shared.folder / "main") as port:
        await_ping(port)


def test_the_link_of_one_that_was_killed_is_taken_over(tmp_path: Path) -> None:
    killed = Virtual(tmp_path)
    killed.process.kill()
    killed.process.communicate()
    assert (tmp_path / "main").is_symlink()
    with virtual(tmp_path), client(tmp_path / "main") as port:
        await_ping(port)


def test_the_watchdog_trips_within_120_ms_of_the_last_packet_by_the_servos_clock(shared: Virtual) -> None:
    with client(shared.folder / "main") as port:
        talk = sdk.PacketHandler(2.0)
        for address, value in ((98, 5), (64, 1)):
            write = sdk.GroupSyncWrite(port, talk, address, 1)
            for id in IDS:
                write.addParam(id, [value])
            assert write.txPacket() == 0
        time.sleep(0.06)
        assert not any(servo["tripped"] for servo in shared.servos())
        time.sleep(0.3)
        servos = shared.servos()
        assert all(servo["tripped"] and servo["torque"] and servo["watchdog"] == 255 for servo in servos)
        assert max(servo["trip_delay"] for servo in servos) <= 0.120
        time.sleep(0.2)
        for before, after in zip(servos, shared.servos(), strict=True):
            assert abs(after["position"] - before["position"]) <= 2


def test_a_bus_alone_is_served_so_that_each_may_have_a_process_of_its_own(tmp_path: Path) -> None:
    apart = ("--robot", "h24-mixed", "--muscles", "first-order", "--bus", "l_leg", "--bus", "upper")
    with virtual(tmp_path, *apart) as robot:
        assert sorted(line.split()[1] for line in robot.said) == ["l_leg", "upper"]


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_cleanly(tmp_path: Path, end: signal.Signals) -> None:
    with virtual(tmp_path) as robot:
        robot.process.send_signal(end)
        assert robot.process.wait(5.0) == 0
        assert not (tmp_path / "faults").exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--robot", "h42"], "h24"),
        (["--baud", "12345"], "9600"),
        (["--return-delay", "7"], "508"),
        (["--calibration", "x.txt"], "NAME.yaml"),
        (["--robot", "h24-mixed", "--bus", "leg"], "upper, l_leg, r_leg"),
        (["--robot", "h24-mixed", "--bus", "l_leg"], "first-order"),
        (["--servo", "a:1:XM430-W350", "--bus", "a"], "--bus needs --robot"),
    ],
)
def test_an_impossible_start_option_is_reported_and_exits_with_two(
    options: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(options) == 2
    assert says in capsys.readouterr().err


def test_ground_truth_is_read_or_drawn_and_a_hand_order_moves_uncalibrated_joints(tmp_path: Path) -> None:
    (tmp_path / "truth.json").write_text('{"joints": {"l_knee": {"zero_ticks": 4000, "turns": 1}}}')
    with bench(tmp_path, "--truth", str(tmp_path / "truth.json")) as robot:
        assert not (tmp_path / "fits.yaml").exists()
        knee = next(each for each in robot.servos() if each["id"] == 16)
        assert (knee["encoder"], knee["position"]) == (4000.0, 8096.0)
        assert robot.order(fault="hand", pose={"l_knee": 0.5}, speed=5.0)["ok"]
        deadline = time.monotonic() + 5.0
        while abs(knee["encoder"] - 4000.0) < 325 and time.monotonic() < deadline:
            knee = next(each for each in robot.servos() if each["id"] == 16)
        assert abs(knee["encoder"] - 4000.0) == pytest.approx(326, abs=1)
        assert robot.order(fault="hand", off=True)["ok"]
        assert "no joint 'tail'" in robot.order(fault="hand", pose={"tail": 0.5})["error"]
    with virtual(tmp_path, "--truth-seed", "7") as robot:
        drawn = {
            joint.id: joint for joint in load_calibration(tmp_path / "fits.yaml", load_robot("h24")).joints
        }
        found = {each["id"]: round(each["position"]) for each in robot.servos()}
        assert all((found[id] - drawn[id].zero_ticks) % 4096 == 0 for id in IDS)
        assert len({drawn[id].zero_ticks for id in IDS}) > 20, "zeros are drawn"
        assert len({drawn[id].zero_ticks // 512 for id in IDS}) > 4, "and lie anywhere on the encoder"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--truth", "t.yaml", "--truth-seed", "1"], "a truth is given or drawn, not both"),
        (["--truth-seed", "-1"], "--truth-seed -1: it is 0 or more"),
        (["--servo", "main:1:XM430-W350", "--truth-seed", "1"], "--truth-seed needs --robot"),
        (["--truth", "/nowhere/t.yaml"], "/nowhere/t.yaml"),
    ],
)
def test_an_invalid_ground_truth_is_refused_before_a_port_exists(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], words: str
) -> None:
    assert main(["--link", str(tmp_path), "--muscles", "first-order", *options]) == 2
    assert words in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
