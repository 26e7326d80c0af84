"""The front's listening sockets: what is checked, bound again and reported. Real sockets, one process."""

import asyncio
import errno
import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from twind import link, listening_sockets
from twind.exceptions import OperationFailed
from twind.front.socket_acceptor import SocketAcceptor
from twind.listening_sockets import Listener, listen


class Wire:
    """The front's end of the link: keeps what is sent. `full`: it takes no descriptor."""

    def __init__(self) -> None:
        self.is_closed = self.full = False
        self.sent: list[link.Inward] = []

    def send(self, command: link.Inward, fd: int | None = None) -> bool:
        if self.full:
            return False
        assert fd is not None
        self.sent.append(command)
        return True

    def owe(self, command: link.Inward) -> None:
        self.sent.append(command)


class Desk:
    """Both sockets of a front in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.wire = Wire()
        self.loop = asyncio.new_event_loop()
        self.accepted: list[str] = []
        self.listening = SocketAcceptor(self.loop, self.wire, self._accept)  # type: ignore[arg-type]

    def add(self, *, own: bool = True, checked: bool = True) -> None:
        for name in ("control", "observe"):
            self.listening.add(name, Listener.of(listen(self.folder, name), own=own), checked=checked)

    def open(self, *, own: bool = True, checked: bool = True) -> None:
        self.add(own=own, checked=checked)
        self.listening.open()

    def close(self) -> None:
        self.listening.close()
        self.loop.close()

    def report(self) -> link.Reachable:
        """Check the sockets; return the single report to the loop."""
        self.listening.check()
        (report,) = self.wire.sent
        assert isinstance(report, link.Reachable)
        return report

    def _accept(self, listener: socket.socket, role: str) -> None:
        listener.accept()[0].close()
        self.accepted.append(role)

    def remove(self, name: str = "control") -> Path:
        path = self.folder / f"{name}.sock"
        path.unlink()
        return path

    def connect(self, name: str) -> None:
        """A client, and one round of the event loop."""
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(self.folder / f"{name}.sock"))
            self.loop.run_until_complete(asyncio.sleep(0.0))
            self.loop.run_until_complete(asyncio.sleep(0.0))


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    made = Desk(tmp_path)
    yield made
    made.close()


def test_the_first_report_confirms_the_sockets_and_none_follows(desk: Desk) -> None:
    desk.add()
    desk.listening.check()
    assert desk.wire.sent == [], "nothing before clients are accepted"
    desk.listening.open()
    for _ in range(3):
        desk.listening.check()
    assert desk.wire.sent == [link.Reachable(rebound=[])]


def test_a_removed_socket_is_bound_again_handed_to_the_loop_and_served_by_its_role(desk: Desk) -> None:
    desk.open()
    desk.listening.check()
    path = desk.remove("observe")
    desk.listening.check()
    _, rebound, report = desk.wire.sent
    assert isinstance(rebound, link.Rebound) and rebound.name == "observe"
    assert report == link.Reachable(rebound=[str(path)])
    desk.connect("observe")
    desk.connect("control")
    assert desk.accepted == ["observer", "operator"]


def test_a_link_that_takes_no_socket_is_reported_and_tried_again(desk: Desk) -> None:
    desk.open()
    path = desk.remove()
    desk.wire.full = True
    assert "the loop does not take the new socket" in desk.report().missing
    desk.wire.full = False
    desk.listening.check()
    assert desk.wire.sent[-1] == link.Reachable(rebound=[str(path)])
    desk.connect("control")
    assert desk.accepted == ["operator"]


def test_nothing_is_bound_after_the_loop_has_ended(desk: Desk) -> None:
    desk.open()
    path = desk.remove()
    desk.wire.is_closed = True
    desk.listening.check()
    assert not path.exists() and desk.wire.sent == []


@pytest.mark.parametrize("file", [None, "text"])
def test_a_missing_socket_of_the_service_manager_is_reported_with_the_command(
    desk: Desk, file: str | None
) -> None:
    desk.open(own=False)
    path = desk.remove()
    if file is not None:
        path.write_text(file)
    report = desk.report()
    assert str(path) in report.missing
    assert "`systemctl restart twind-control.socket twind-observe.socket twind.service`" in report.missing
    assert path.exists() is (file is not None)


def test_a_folder_that_is_removed_while_a_socket_is_bound_again_is_no_loss(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`rm -r` removes the files, then the folder: a check between the two still finds the folder."""
    desk.open()
    desk.remove("control")
    desk.remove("observe")
    check_folder = listening_sockets.check_folder
    gone = list[Path]()

    def checked(folder: Path) -> None:
        check_folder(folder)
        if not gone:
            gone.append(folder)
            folder.rmdir()

    monkeypatch.setattr(listening_sockets, "check_folder", checked)
    desk.listening.check()
    reports = [each for each in desk.wire.sent if isinstance(each, link.Reachable)]
    assert gone and [(each.missing, len(each.rebound)) for each in reports] == [("", 2)]
    desk.connect("control")
    assert desk.accepted == ["operator"]


def test_the_command_for_a_socket_of_an_instance_names_the_units_of_that_instance(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The units of the plain service would lower another robot."""
    monkeypatch.setattr("twind.front.socket_acceptor.SYSTEM", str(tmp_path), raising=False)
    desk = Desk(tmp_path / "arm")
    try:
        desk.open(own=False)
        desk.remove()
        report = desk.report()
    finally:
        desk.close()
    units = "twind-control@arm.socket twind-observe@arm.socket twind@arm.service"
    assert f"`systemctl restart {units}`" in report.missing


def test_a_folder_that_went_away_from_a_service_is_refused_with_what_brings_it_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A removed folder takes its writable mount along; one that is made in its place is read-only."""

    def mkdir(*_args: object, **_options: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(Path, "mkdir", mkdir)
    with pytest.raises(
        OperationFailed, match=r"systemd-tmpfiles --create.*restart the service, which lowers"
    ):
        listen(tmp_path / "run", "control")


def test_a_socket_whose_file_is_not_known_is_not_checked(desk: Desk) -> None:
    desk.open(checked=False)
    path = desk.remove()
    desk.listening.check()
    assert not path.exists() and desk.wire.sent == [link.Reachable(rebound=[])]


def test_a_socket_that_rests_is_served_again_once_opened(desk: Desk) -> None:
    first = Listener.of(listen(desk.folder, "control"), own=True)
    desk.listening.add("control", first, checked=True)
    desk.listening.open()
    desk.listening.rest(first.bound)
    desk.connect("control")
    assert desk.accepted == []
    desk.listening.open()
    desk.connect("control")
    assert "operator" in desk.accepted
