"""Search for the daemon of a folder, beside processes of other users. Real processes and sockets."""

import argparse
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from twind.client import NoDaemon
from twind.command_line.verb import Rejected
from twind.ctl import estop, lost_socket_daemon
from twind.ctl.lost_socket_daemon import LostSocketDaemon

FRONT = """
import os, sys
os.setuid(int(sys.argv[-1]))
print("ready", flush=True)
sys.stdin.read()
"""
DAEMON = f"""
FRONT = {FRONT!r}
import os, socket, subprocess, sys
bound = dict()
for name in ("control", "observe"):
    bound[name] = socket.socket(socket.AF_UNIX)
    bound[name].bind(sys.argv[1] + "/" + name + ".sock")
    bound[name].listen()
    os.unlink(sys.argv[1] + "/" + name + ".sock")
own, given, user = sys.argv[2:]
words = ["-m", "twind.front", "--parent", str(os.getpid())]
front = subprocess.Popen(
    [sys.executable, "-c", FRONT, *words, user],
    pass_fds=[bound[given].fileno()],
    stdin=subprocess.PIPE,
    stdout=subprocess.PIPE,
)
for name in set(bound) - set([own]):
    bound[name].close()
print(front.stdout.readline().decode(), end="", flush=True)
sys.stdin.read()
"""


@contextmanager
def daemon(
    folder: Path, own: str = "control", given: str = "control", user: int | None = None
) -> Iterator["subprocess.Popen[str]"]:
    """A process that keeps the socket `own`, and whose front, of `user`, has the socket `given`."""
    uid = os.geteuid() if user is None else user
    words = [sys.executable, "-c", DAEMON, str(folder), own, given, str(uid)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None and process.stdout.readline() == "ready\n"
            yield process
        finally:
            process.kill()


def test_a_daemon_is_found_by_the_socket_that_it_shares_with_its_front(tmp_path: Path) -> None:
    with daemon(tmp_path) as process:
        assert lost_socket_daemon.find([str(tmp_path)], 0.0) == [
            LostSocketDaemon(str(tmp_path), os.geteuid(), process.pid)
        ]


@pytest.mark.parametrize("name", ["line\nbreak", "\n0: 2 0 no-number 0001 01 1 /x/control.sock"])
def test_a_socket_of_any_user_whose_name_breaks_the_line_hides_no_daemon(tmp_path: Path, name: str) -> None:
    with daemon(tmp_path) as process, socket.socket(socket.AF_UNIX) as odd:
        odd.bind(f"\0{os.getpid()} {name}")
        odd.listen()
        assert [each.pid for each in lost_socket_daemon.find([str(tmp_path)], 0.0)] == [process.pid]


def test_a_parent_that_listens_on_another_socket_of_the_folder_is_no_daemon(tmp_path: Path) -> None:
    with daemon(tmp_path, own="observe", given="control"):
        assert lost_socket_daemon.find([str(tmp_path)], 0.0) == []


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can start a process of another user")
def test_a_front_of_another_user_makes_no_process_a_daemon(tmp_path: Path) -> None:
    with daemon(tmp_path, user=65534):
        assert lost_socket_daemon.find([str(tmp_path)], 0.0) == []


def test_a_daemon_that_ended_before_it_is_signalled_is_reported_as_ended(tmp_path: Path) -> None:
    with daemon(tmp_path) as process:
        (found,) = lost_socket_daemon.find([str(tmp_path)], 0.0)
        process.kill()
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # its parent has not collected it yet
        with pytest.raises(ProcessLookupError):
            lost_socket_daemon.terminate(found)


def test_a_daemon_that_may_not_be_signalled_keeps_no_other_one_from_being_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with daemon(tmp_path) as process:
        (mine,) = lost_socket_daemon.find([str(tmp_path)], 0.0)
        foreign = LostSocketDaemon(str(tmp_path), 65534)
        monkeypatch.setattr(lost_socket_daemon, "find", lambda _folders: [foreign, mine])
        options = argparse.Namespace(socket=str(tmp_path), remote=None, json=False, cut=False, reason=None)
        with pytest.raises(Rejected, match="uid 65534 serves it, which this user may not signal"):
            estop.terminate_daemons(options, NoDaemon("no such socket", absent=True))
        assert process.wait(5.0) == -signal.SIGTERM
        assert f"(pid {process.pid}) serves it: SIGTERM sent" in capsys.readouterr().out
