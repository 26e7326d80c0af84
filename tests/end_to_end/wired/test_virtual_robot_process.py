"""`--virtual`: a robot of our own that is there when we are, and gone with its files when we are."""

import os
import signal
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import until
from twind.config.calibration_file import load_calibration
from twind.config.robot_file import load_robot
from twind.exceptions import OperationFailed
from twind.loop.process.virtual_robot_process import VirtualRobotProcess
from twind_drivers.bus import PortError
from twind_drivers.ports.serial_port import SerialTransport

PARENT = """
import sys, time
from twind.loop.process.virtual_robot_process import VirtualRobotProcess

child = VirtualRobotProcess("h24-split")
child.__enter__()
print(child._process.pid, *child.ports.values(), flush=True)
time.sleep(60)
"""


def children() -> set[str]:
    return set(Path(f"/proc/self/task/{os.getpid()}/children").read_text().split())


def test_the_virtual_robot_is_ready_on_entry_and_removed_with_its_folder_on_exit() -> None:
    before = children()
    with VirtualRobotProcess("h24") as child:
        (pid,) = children() - before
        assert list(child.ports) == ["main"]
        assert stat.S_ISCHR(os.stat(child.ports["main"]).st_mode)
        assert load_calibration(child.calibration, load_robot("h24")).joints
        assert child.faults.is_socket()
        folder = child.calibration.parent
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        assert os.getsid(int(pid)) == int(pid)  # Ctrl-C reaches the loop alone, which lowers the robot first
    assert not folder.exists()
    assert children() == before
    child.close()  # twice is no harm


def test_the_virtual_robot_imports_no_local_module_and_gets_no_service_manager_variables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("yaml", "mujoco", "twind"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('a module of the current folder ran')")
    monkeypatch.chdir(tmp_path)
    theirs = ("LISTEN_FDS", "LISTEN_PID", "LISTEN_FDNAMES", "NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
    for key in theirs:
        monkeypatch.setenv(key, "1")
    before = children()
    with VirtualRobotProcess("h24"):
        (pid,) = children() - before
        given = Path(f"/proc/{pid}/environ").read_bytes().decode().split("\0")
        assert not [one for one in given if one.startswith(theirs)]
        assert f"PATH={os.environ['PATH']}" in given


def test_the_bus_of_a_virtual_robot_that_has_ended_names_that_and_is_not_opened_again() -> None:
    before = children()
    opened: list[str] = []

    def opener(name: str) -> Any:
        opened.append(name)

    with VirtualRobotProcess("h24") as child:
        guarded = child.guarded(opener)
        guarded("main")
        (pid,) = children() - before
        port = SerialTransport(child.ports["main"], 2_000_000)
        os.kill(int(pid), signal.SIGKILL)

        os.waitid(os.P_PID, int(pid), os.WEXITED | os.WNOWAIT)
        with pytest.raises(PortError, match=r"\(its program has ended\?\)$"):
            port.backlog()
        port.close()
        with pytest.raises(PortError, match=r"the virtual robot has ended \(exit code -9\)"):
            guarded("main")
        with pytest.raises(PortError, match="no such port: the program that served it has ended"):
            SerialTransport(child.ports["main"], 2_000_000)
    assert opened == ["main"]


def test_the_virtual_robot_ends_when_its_parent_is_killed(tmp_path: Path) -> None:
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT], stdout=subprocess.PIPE, env={**os.environ, "TMPDIR": str(tmp_path)}
    )
    assert parent.stdout is not None
    pid, *ports = parent.stdout.readline().decode().split()
    parent.stdout.close()
    assert len(ports) == 2
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait(10)

    def gone() -> bool:
        try:
            return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
        except FileNotFoundError:
            return True

    until(gone, 10.0, "the virtual robot ends with its parent")


def test_a_robot_that_does_not_start_is_an_error_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    before = children()
    with pytest.raises(OperationFailed, match="did not start"), VirtualRobotProcess("no-such-robot"):
        pass
    assert children() == before
    assert list(tmp_path.iterdir()) == []
