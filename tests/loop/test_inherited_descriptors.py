"""Descriptors of the service manager are taken by name, and never passed on."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from twind.loop.ipc.inherited_descriptors import InheritedDescriptors, handed_over

HANDED = """
import fcntl, json, os, socket, sys
from twind.loop.ipc.inherited_descriptors import handed_over

def inheritable(fd):
    return os.path.exists(f"/proc/self/fd/{fd}") and os.get_inheritable(fd)

setting = json.loads(sys.argv[1])
made = []
for place, name in enumerate(setting["made"]):
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(name)
    listener.listen()
    made.append(fcntl.fcntl(listener.fileno(), fcntl.F_DUPFD, 64))
for place, fd in enumerate(made):
    os.dup2(fd, 3 + place, inheritable=True)
os.environ |= {"LISTEN_FDS": str(len(made)), "LISTEN_PID": str(os.getpid())} | setting["environment"]
found = handed_over()
print(json.dumps({
    "found": {name: one.getsockname() for name, one in found.sockets.items()},
    "wreck": found.wreck,
    "inheritable": [inheritable(3 + place) for place in range(len(made))],
    "left": [key for key in os.environ if key.startswith("LISTEN_")],
}))
"""


def handed(folder: Path, made: list[str], **environment: str) -> dict[str, Any]:
    setting = json.dumps({"made": made, "environment": environment})
    done = subprocess.run(
        [sys.executable, "-c", HANDED, setting],
        capture_output=True,
        text=True,
        timeout=30,
        cwd=folder,
        check=True,
    )
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer | {"said": done.stderr}


def test_sockets_are_taken_by_name_and_not_by_place(tmp_path: Path) -> None:
    answer = handed(tmp_path, ["o", "x", "c"], LISTEN_FDNAMES="observe:varlink:control")
    assert answer["found"] == {"observe": "o", "control": "c"}
    assert answer["inheritable"] == [False] * 3
    assert answer["left"] == []
    assert answer["said"] == (
        "twind: a socket named 'varlink' was handed over, and is not served: "
        "FileDescriptorName= of its unit must be control or observe\n"
    )


def test_sockets_without_names_are_not_ours_and_are_not_passed_on_either(tmp_path: Path) -> None:
    answer = handed(tmp_path, ["a"], LISTEN_FDNAMES="")
    assert answer.pop("said").startswith("twind: a socket named '' was handed over")
    assert answer == {"found": {}, "wreck": None, "inheritable": [False], "left": []}


def test_sockets_meant_for_another_process_are_left_alone(tmp_path: Path) -> None:
    answer = handed(tmp_path, ["c"], LISTEN_FDNAMES="control", LISTEN_PID="1")
    assert answer == {"found": {}, "wreck": None, "inheritable": [True], "left": [], "said": ""}


def test_the_crash_recording_is_separated_by_name_and_only_the_last_is_taken(
    tmp_path: Path,
) -> None:
    answer = handed(tmp_path, ["f", "c", "g"], LISTEN_FDNAMES="flight:control:flight")
    assert (answer["found"], answer["wreck"], answer["said"]) == ({"control": "c"}, 5, "")
    assert answer["inheritable"] == [False] * 3


@pytest.mark.parametrize("count", ["", "-1", "two", "0"])
def test_a_count_that_is_none_hands_nothing_over(monkeypatch: pytest.MonkeyPatch, count: str) -> None:
    monkeypatch.setenv("LISTEN_FDS", count)
    monkeypatch.setenv("LISTEN_PID", str(os.getpid()))
    monkeypatch.setenv("LISTEN_FDNAMES", "control:observe")
    assert handed_over() == InheritedDescriptors()
    assert not any(key.startswith("LISTEN_") for key in os.environ)


def test_without_a_service_manager_nothing_is_handed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    for key in ("LISTEN_FDS", "LISTEN_PID", "LISTEN_FDNAMES"):
        monkeypatch.delenv(key, raising=False)
    assert handed_over() == InheritedDescriptors()
