"""The listening sockets: nobody else's are taken, none is ever open to all, and only the dead make room."""

import grp
import json
import os
import socket
import stat
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from twind.exceptions import OperationFailed
from twind.listening_sockets import GROUPS, Listener, group_of, listen
from twind.loop.inherited_descriptors import InheritedDescriptors, handed_over


@contextmanager
def umask(mask: int) -> Iterator[None]:
    old = os.umask(mask)
    try:
        yield
    finally:
        assert os.umask(old) == mask  # nobody changed it meanwhile


@pytest.fixture
def keep() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


# ------------------------------------------------------------------------------------- our own


def test_a_socket_is_made_with_its_folder_and_answers(tmp_path: Path, keep: ExitStack) -> None:
    folder = tmp_path / "run" / "twind"
    with umask(0o022):
        listener = keep.enter_context(listen(folder, "control"))
    client = keep.enter_context(socket.socket(socket.AF_UNIX))
    client.connect(str(folder / "control.sock"))
    accepted, _ = listener.accept()
    accepted.close()
    assert stat.S_IMODE(folder.stat().st_mode) == 0o755
    assert not listener.get_inheritable()


@pytest.mark.parametrize("mask", [0o000, 0o027, 0o077])
def test_the_groups_can_enter_a_folder_of_ours_and_one_that_was_there_stays(
    tmp_path: Path, keep: ExitStack, mask: int
) -> None:
    there = tmp_path / "there"
    there.mkdir(mode=0o700)
    with umask(mask):
        keep.enter_context(listen(tmp_path / "made", "control"))
        keep.enter_context(listen(there, "control"))
    assert stat.S_IMODE((tmp_path / "made").stat().st_mode) == 0o755
    assert stat.S_IMODE(there.stat().st_mode) == 0o700


def test_the_group_of_a_socket_is_reported(
    tmp_path: Path, keep: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours = grp.getgrgid(os.getegid()).gr_name
    monkeypatch.setitem(GROUPS, "control", "no-such-group")
    assert group_of(keep.enter_context(listen(tmp_path, "control"))) == ours
    if os.geteuid() == 0:
        other = grp.getgrgid(65534).gr_name
        monkeypatch.setitem(GROUPS, "observe", other)
        assert group_of(keep.enter_context(listen(tmp_path, "observe"))) == other
    (tmp_path / "control.sock").unlink()
    assert [group_of(one) for one in (keep.enter_context(socket.socket(socket.AF_UNIX)),)] == [""]


@pytest.mark.parametrize("mode", [0o777, 0o757, 0o1777])
def test_a_folder_that_others_may_write_to_is_refused(tmp_path: Path, mode: int) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    folder.chmod(mode)
    with pytest.raises(OperationFailed, match=rf"others may write there \(mode {mode:04o}\); `chmod go-w`"):
        listen(folder, "control")
    assert list(folder.iterdir()) == []


def test_a_folder_that_our_own_group_may_write_to_is_ours(tmp_path: Path, keep: ExitStack) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    os.chown(folder, -1, os.getegid())
    folder.chmod(0o775)
    keep.enter_context(listen(folder, "control"))


def test_a_folder_that_is_a_symbolic_link_is_refused(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    with pytest.raises(OperationFailed, match="is a symbolic link; give the folder it points to"):
        listen(tmp_path / "link", "control")
    assert list((tmp_path / "real").iterdir()) == []


needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")


@needs_root
@pytest.mark.parametrize("place", ["folder", "socket"])
def test_a_socket_or_folder_of_another_user_is_refused_and_unchanged(tmp_path: Path, place: str) -> None:
    folder = tmp_path / "run"
    listen(folder, "control").close()
    path = folder / "control.sock"
    os.chown(folder if place == "folder" else path, 65534, -1)
    before = path.lstat()
    with pytest.raises(OperationFailed, match=r"belongs to .*uid 65534.*run twind as that user, `chown` it"):
        listen(folder, "control")
    assert path.lstat() == before


@needs_root
def test_a_folder_that_another_group_may_write_to_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    os.chown(folder, -1, 65534)
    folder.chmod(0o775)
    with pytest.raises(OperationFailed, match="others may write there"):
        listen(folder, "control")


@pytest.mark.parametrize("mask", [0o000, 0o022, 0o077, 0o777])
def test_the_mode_is_0660_whatever_the_umask(tmp_path: Path, keep: ExitStack, mask: int) -> None:
    with umask(mask):
        keep.enter_context(listen(tmp_path, "observe"))
    assert stat.S_IMODE((tmp_path / "observe.sock").stat().st_mode) == 0o660


BIRTH = """
import os, socket, stat, sys
from pathlib import Path
from twind.listening_sockets import listen

folder, seen = Path(sys.argv[1]), []

def watch(event, args):  # a chmod would be an audited step after the birth
    if (folder / "control.sock").exists():
        seen.append(oct(stat.S_IMODE(os.stat(folder / "control.sock").st_mode)))

os.umask(0)
sys.addaudithook(watch)
listen(folder, "control").close()
sys.audit("born")
print(*sorted(set(seen)))
"""


def test_the_mode_is_0660_from_the_moment_of_birth(tmp_path: Path) -> None:
    assert child(BIRTH, str(tmp_path)).split() == ["0o660"]


def test_a_socket_without_a_listener_is_replaced(tmp_path: Path, keep: ExitStack) -> None:
    listen(tmp_path, "control").close()
    keep.enter_context(listen(tmp_path, "control"))
    client = keep.enter_context(socket.socket(socket.AF_UNIX))
    client.connect(str(tmp_path / "control.sock"))  # it got through: the name is the same, the socket new


def test_a_second_daemon_is_refused_and_the_first_goes_on(tmp_path: Path, keep: ExitStack) -> None:
    first = keep.enter_context(listen(tmp_path, "control"))
    with pytest.raises(OperationFailed, match="another twind answers there; stop it or choose"):
        listen(tmp_path, "control")
    client = keep.enter_context(socket.socket(socket.AF_UNIX))
    client.connect(str(tmp_path / "control.sock"))
    first.setblocking(False)
    for _ in range(2):  # the one that looked, and ours
        first.accept()[0].close()


def test_a_hanging_daemon_counts_as_present_and_is_not_waited_for(tmp_path: Path, keep: ExitStack) -> None:
    hanging = keep.enter_context(socket.socket(socket.AF_UNIX))
    hanging.bind(str(tmp_path / "control.sock"))
    hanging.listen(0)
    while True:  # until its queue is full
        client = keep.enter_context(socket.socket(socket.AF_UNIX))
        client.setblocking(False)
        if client.connect_ex(str(tmp_path / "control.sock")):
            break
    with pytest.raises(OperationFailed, match="another twind answers there"):
        listen(tmp_path, "control")
    assert (tmp_path / "control.sock").is_socket()


def test_a_path_that_is_no_socket_is_never_removed(tmp_path: Path) -> None:
    path = tmp_path / "control.sock"
    path.write_text("precious")
    with pytest.raises(OperationFailed, match=r"control\.sock: is not a socket"):
        listen(tmp_path, "control")
    assert path.read_text() == "precious"
    path.unlink()
    path.mkdir()
    with pytest.raises(OperationFailed, match="is not a socket"):
        listen(tmp_path, "control")
    assert path.is_dir()


@pytest.mark.parametrize("target", ["dead", "precious", "nothing"])
def test_a_symbolic_link_is_refused_wherever_it_points(tmp_path: Path, target: str) -> None:
    if target == "dead":
        listen(tmp_path, "dead").close()
    (tmp_path / "precious").write_text("precious")
    (tmp_path / "control.sock").symlink_to(tmp_path / {"dead": "dead.sock"}.get(target, target))
    before = sorted(path.name for path in tmp_path.iterdir())
    with pytest.raises(OperationFailed, match="is not a socket"):
        listen(tmp_path, "control")
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_a_socket_of_another_kind_is_refused(tmp_path: Path, keep: ExitStack) -> None:
    other = keep.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
    other.bind(str(tmp_path / "control.sock"))
    with pytest.raises(OperationFailed, match=r"control\.sock: .*--socket DIR"):
        listen(tmp_path, "control")
    assert (tmp_path / "control.sock").is_socket()


def test_a_folder_that_cannot_be_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OperationFailed, match=r"file/run/control\.sock: .*--socket DIR"):
        listen(tmp_path / "file" / "run", "control")


@pytest.mark.skipif(not Path("/sys").is_dir(), reason="no /sys, where nobody may make a folder")
def test_a_folder_that_cannot_be_made_is_reported_with_the_command() -> None:
    with pytest.raises(
        OperationFailed, match=r"`sudo install -d -o \S+ /sys/twind` makes its folder, or choose"
    ):
        listen(Path("/sys/twind"), "control")


def test_a_path_too_long_for_a_socket_is_refused_and_nothing_stays_open(tmp_path: Path) -> None:
    before = len(os.listdir("/proc/self/fd"))
    with umask(0o022), pytest.raises(OperationFailed, match="too long; choose another folder"):
        listen(tmp_path / ("x" * 120), "control")
    assert len(os.listdir("/proc/self/fd")) == before


# ------------------------------------------------------------------------------------- their files


def test_a_listener_is_in_place_until_its_file_is_removed_or_replaced(
    tmp_path: Path, keep: ExitStack
) -> None:
    path = tmp_path / "control.sock"
    bound = keep.enter_context(listen(tmp_path, "control"))
    listener = Listener.of(bound, own=True)
    assert listener.path == path and listener.in_place
    os.utime(path)
    path.chmod(0o600)
    assert listener.in_place
    path.rename(tmp_path / "moved")
    assert not listener.in_place
    path.write_text("another file")
    assert not listener.in_place
    path.unlink()
    keep.enter_context(listen(tmp_path, "control"))
    assert not listener.in_place
    path.unlink()
    (tmp_path / "moved").rename(path)
    assert listener.in_place


@pytest.mark.parametrize("own", [True, False])
def test_remove_deletes_the_file_of_an_own_socket_only(tmp_path: Path, own: bool) -> None:
    listener = Listener.of(listen(tmp_path, "control"), own=own)
    for _ in range(2):  # a second call does nothing
        listener.remove()
        assert (tmp_path / "control.sock").exists() is not own
    assert listener.bound.fileno() == -1


def test_remove_leaves_the_file_that_another_daemon_bound_in_its_place(
    tmp_path: Path, keep: ExitStack
) -> None:
    listener = Listener.of(listen(tmp_path, "control"), own=True)
    (tmp_path / "control.sock").unlink()
    keep.enter_context(listen(tmp_path, "control"))
    listener.remove()
    assert (tmp_path / "control.sock").is_socket()


def test_a_file_of_the_same_inode_number_cannot_follow_while_the_socket_is_open(
    tmp_path: Path, keep: ExitStack
) -> None:
    bound = keep.enter_context(listen(tmp_path, "control"))
    listener = Listener.of(bound, own=True)
    path = tmp_path / "control.sock"
    for _ in range(50):
        path.unlink()
        listen(tmp_path, "control").close()
        assert not listener.in_place


def test_an_inherited_listener_keeps_its_file_and_ownership(tmp_path: Path) -> None:
    for own in (True, False):
        first = Listener.of(listen(tmp_path, "control"), own=own)
        second = Listener.inherited(os.dup(first.bound.fileno()), first.label)
        assert (second.own, second.in_place, second.label) == (own, True, first.label)
        first.close()
        (tmp_path / "control.sock").unlink()
        assert not second.in_place
        second.close()


def test_a_socket_that_was_handed_over_without_its_file_is_not_in_place(
    tmp_path: Path, keep: ExitStack
) -> None:
    bound = keep.enter_context(listen(tmp_path, "control"))
    (tmp_path / "control.sock").unlink()
    assert not Listener.of(bound, own=False).in_place


def test_an_abstract_socket_has_no_file_to_lose(keep: ExitStack) -> None:
    bound = keep.enter_context(socket.socket(socket.AF_UNIX))
    bound.bind(f"\0twind-test-{os.getpid()}")
    listener = Listener.of(bound, own=False)
    assert listener.path is None and listener.in_place


# ------------------------------------------------------------------------------------- handed over


HANDED = """
import fcntl, json, os, socket, sys
from twind.loop.inherited_descriptors import handed_over

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


def child(code: str, *arguments: str, cwd: Path | None = None) -> str:
    """Return the output of a process."""
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=30, cwd=cwd
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


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
