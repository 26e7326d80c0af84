"""The loop's end of the link over a real socket pair: ordered, bounded, and never a reason to be late."""

import os
import socket
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from twind import link, sealed_memfd
from twind.listening_sockets import Listener, listen
from twind.loop.ipc.front_link import BEHIND, LARGEST, PER_TICK, QUEUE, FrontLink


class Front:
    """A front in the test's hands: a socket pair, and a note of what was done to it."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.socket: socket.socket | None = None
        self.outer: socket.socket | None = None
        self.is_due = False
        self.is_overdue = False
        self.has_ended = False
        self.cannot_start = False
        self.fate = "(7) ended with signal 9"
        self.start(0.0)
        self.said.clear()

    def start(self, now: float) -> None:
        self.said.append("start")
        if self.cannot_start:
            raise OSError("no process to be had")
        if self.outer is not None:
            self.outer.close()
        self.socket, self.outer = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.socket.setblocking(False)
        self.outer.setblocking(False)
        self.is_due = False

    def end(self, now: float) -> None:
        self.said.append("end")
        if self.socket is not None:
            self.socket.close()
        self.socket = None
        self.is_overdue = False

    def finish(self) -> None:
        self.said.append("finish")
        if self.socket is not None:
            self.socket.close()

    def postpone(self, now: float) -> None:
        self.said.append("postpone")
        self.is_due = False

    def alive(self, now: float) -> None:
        self.said.append(f"alive at {now:g}")

    def overdue(self, now: float) -> bool:
        return self.is_overdue

    def reap(self) -> bool:
        ended = self.has_ended
        self.has_ended = False
        return ended

    def due(self, now: float) -> bool:
        return self.is_due

    # ------------------------------------------------------------- the outer end

    def send(self, command: Any, *fds: int) -> None:
        assert self.outer is not None
        data = command if isinstance(command, bytes) else link.encode(command)
        socket.send_fds(self.outer, [data], list(fds))

    def news(self) -> list[Any]:
        """Everything that has arrived."""
        assert self.outer is not None
        found = []
        while True:
            try:
                data = self.outer.recv(link.DATAGRAM)
            except (BlockingIOError, ConnectionResetError):
                return found
            if not data:
                return found
            found.append(link.decode_news(data))


@pytest.fixture
def front() -> Iterator[Front]:
    front = Front()
    yield front
    for end in (front.socket, front.outer):
        if end is not None:
            end.close()


class RecordingStandIn:
    """Recording of a former daemon; `dones` counts its releases."""

    def __init__(self) -> None:
        self.dones = 0

    def done(self) -> None:
        self.dones += 1


@pytest.fixture
def end(front: Front) -> FrontLink:
    return FrontLink(front)  # type: ignore[arg-type]


def cancel(ticket: int) -> link.Cancel:
    return link.Cancel(ticket=ticket, client=1)


def reply(ticket: int) -> link.Reply:
    return link.Reply(ticket=ticket)


def tick(sequence: int, dropped: int = 0) -> link.Tick:
    some = bytes(24 * 8)
    return link.Tick(
        time=0.0,
        sequence=sequence,
        mode="sim",
        state="disconnected",
        motion="holding",
        armed=False,
        inherited=False,
        position=some,
        velocity=some,
        effort=some,
        age=some,
        heard=bytes(24),
        goal=some,
        simulated=some,
        read=0.0,
        raw=some,
        raw_effort=some,
        raw_age=some,
        dropped=dropped,
    )


def fill(end: FrontLink) -> int:
    """Ticks until the pipe is full; how many went in."""
    for sequence in count():
        before = end.dropped
        end.state(tick(sequence))
        if end.dropped > before:
            return sequence
    raise AssertionError


def open_descriptors() -> set[str]:
    return set(os.listdir("/proc/self/fd"))


# ------------------------------------------------------------------------------------- in


def test_commands_come_in_the_order_they_were_sent(front: Front, end: FrontLink) -> None:
    for ticket in range(5):
        front.send(cancel(ticket))
    taken = end.commands(1.0)
    assert [incoming.command.ticket for incoming in taken] == [0, 1, 2, 3, 4]  # type: ignore[union-attr]
    assert end.commands(1.0) == []


def test_a_flood_waits_in_the_pipe_and_not_in_the_loop(front: Front, end: FrontLink) -> None:
    for ticket in range(PER_TICK + 10):
        front.send(cancel(ticket))
    assert len(end.commands(1.0)) == PER_TICK
    assert len(end.commands(1.0)) == 10


def test_a_heartbeat_is_a_sign_of_life_and_no_command(front: Front, end: FrontLink) -> None:
    front.send(link.Heartbeat())
    assert end.commands(7.0) == []
    assert front.said == ["alive at 7"]


def test_the_bytes_of_a_memfd_come_with_their_command_and_the_descriptor_is_let_go(
    front: Front, end: FrontLink
) -> None:
    fd = sealed_memfd.seal("path", b"numbers")
    before = open_descriptors()
    front.send(cancel(1), fd)
    front.send(cancel(2), fd, fd, fd)
    front.send(cancel(3))
    assert [incoming.data for incoming in end.commands(1.0)] == [b"numbers", b"numbers", b""]
    assert open_descriptors() == before
    os.close(fd)


@pytest.mark.parametrize("nonsense", [b"\xc1 no message", link.encode(link.Reply(ticket=1))])
def test_a_front_that_cannot_spell_is_buried(front: Front, end: FrontLink, nonsense: bytes) -> None:
    front.send(cancel(1))
    front.send(nonsense)
    front.send(cancel(2))
    assert [incoming.command for incoming in end.commands(1.0)] == [cancel(1)]
    assert "end" in front.said
    assert end.lost


def loose_memfd() -> int:
    """A memfd whose content can still change."""
    loose = os.memfd_create("loose", os.MFD_ALLOW_SEALING)
    os.write(loose, b"numbers")
    return loose


@pytest.mark.parametrize(
    "make",
    [
        loose_memfd,
        lambda: os.open(os.devnull, os.O_RDONLY),
        lambda: sealed_memfd.seal("path", bytes(LARGEST + 1)),
    ],
    ids=["not sealed", "no memfd", "larger than any trajectory"],
)
def test_a_descriptor_that_is_not_acceptable_costs_the_front_its_life(
    front: Front, end: FrontLink, make: Callable[[], int]
) -> None:
    fd = make()
    before = open_descriptors()
    front.send(cancel(1), fd)
    assert end.commands(1.0) == []
    assert end.lost
    assert len(open_descriptors()) == len(before) - 1  # only the inner end was closed
    os.close(fd)


def test_a_command_sent_before_the_death_of_a_front_still_counts(front: Front, end: FrontLink) -> None:
    front.send(cancel(1))
    assert front.outer is not None
    front.outer.close()
    assert [incoming.command for incoming in end.commands(1.0)] == [cancel(1)]
    assert end.lost
    assert front.socket is None
    assert end.commands(2.0) == []


def test_a_command_of_a_front_that_died_with_unread_news_still_counts(front: Front, end: FrontLink) -> None:
    end.state(tick(1))  # a front that is killed has not read the last state
    front.send(link.EStop(ticket=1, client=2))
    assert front.outer is not None
    front.outer.close()
    assert [type(incoming.command) for incoming in end.commands(1.0)] == [link.EStop]
    assert end.lost
    assert front.socket is None


# ------------------------------------------------------------------------------------- out


def test_a_full_pipe_drops_ticks_and_counts_them_until_one_goes_through(front: Front, end: FrontLink) -> None:
    sent = fill(end)
    end.state(tick(sent + 1))
    assert end.dropped == 2
    assert [news.sequence for news in front.news()] == list(range(sent))
    end.state(tick(sent + 2, dropped=end.dropped))
    assert [(news.sequence, news.dropped) for news in front.news()] == [(sent + 2, 2)]
    assert end.dropped == 0


def test_replies_are_never_dropped_and_keep_their_order(front: Front, end: FrontLink) -> None:
    fill(end)
    for ticket in range(QUEUE):
        end.reply(reply(ticket))
        end.flush()
    end.supervise_front(1.0)
    got = []
    for _ in range(QUEUE):
        got += [news.ticket for news in front.news() if isinstance(news, link.Reply)]
        end.flush()
    assert got == list(range(QUEUE))
    assert not end.lost


def test_a_front_that_lets_the_queue_fill_is_ended_with_its_pending_messages(
    front: Front, end: FrontLink
) -> None:
    fill(end)
    for ticket in range(QUEUE + 1):
        end.reply(reply(ticket))
    end.supervise_front(1.0)
    assert front.said == []  # a moment's crowd is no reason
    end.supervise_front(1.0 + BEHIND + 0.1)
    assert front.said == ["end"]
    assert end.lost
    front.is_due = True
    end.supervise_front(3.0)
    assert front.said == ["end", "start"]
    end.flush()
    assert front.news() == []


def test_events_and_replies_share_one_order(front: Front, end: FrontLink) -> None:
    end.reply(reply(1))
    end.event(link.Event(time=0.0, sequence=end.sequence(), level="info", code="A", message="a"))
    end.event(link.VerdictReport(time=0.0, sequence=end.sequence(), id="t", verdict={}))
    end.reply(reply(2))
    end.flush()
    kinds = [type(news).__struct_config__.tag for news in front.news()]
    assert kinds == ["Reply", "Event", "Moment", "Reply"]


def test_events_are_numbered_one_after_the_other(end: FrontLink) -> None:
    assert [end.sequence() for _ in range(3)] == [1, 2, 3]


def test_without_a_front_replies_wait_for_the_next_one(front: Front, end: FrontLink) -> None:
    front.end(0.0)
    end.event(link.Event(time=0.0, sequence=1, level="error", code="A", message="the front was lost"))
    end.flush()
    end.state(tick(1))
    front.is_due = True
    end.supervise_front(1.0)
    end.flush()
    assert [news.message for news in front.news()] == ["the front was lost"]


# ------------------------------------------------------------------------------------- the front's life


def test_a_front_without_a_sign_of_life_is_buried(front: Front, end: FrontLink) -> None:
    front.is_overdue = True
    end.supervise_front(1.0)
    assert front.said == ["end"]
    assert end.lost


def test_a_front_that_ended_by_itself_is_noticed_and_started_anew_when_due(
    front: Front, end: FrontLink
) -> None:
    front.has_ended = True
    end.supervise_front(1.0)
    assert end.lost
    assert front.said == ["end"]
    end.lost = False
    end.supervise_front(1.1)
    assert front.said == ["end"]
    front.is_due = True
    end.supervise_front(1.2)
    assert front.said == ["end", "start"]
    assert not end.lost


def test_the_end_of_a_front_is_reported_and_its_event_waits_for_the_next_front(
    front: Front, end: FrontLink, capfd: pytest.CaptureFixture[str]
) -> None:
    front.is_overdue = True
    end.supervise_front(1.0)
    front.is_overdue = True
    end.event(link.Event(time=0.0, sequence=1, level="error", code="A", message="the front was lost"))
    end.supervise_front(1.05)  # it may take a while to die
    front.has_ended = True  # the one that was killed
    end.supervise_front(1.1)
    assert capfd.readouterr().err.splitlines() == [
        "twind: the front sends no heartbeat, or takes nothing: it is killed",
        "twind: the front (7) ended with signal 9; another one is started",
    ]
    front.is_due = True
    end.supervise_front(1.2)
    end.flush()
    assert [type(news) for news in front.news()] == [link.Event]


def test_a_front_that_cannot_be_started_is_tried_again_later_and_the_loop_goes_on(
    front: Front, end: FrontLink, capfd: pytest.CaptureFixture[str]
) -> None:
    front.end(0.0)
    front.is_due = front.cannot_start = True
    end.supervise_front(1.0)
    end.supervise_front(1.1)
    end.state(tick(1))
    assert front.said == ["end", "start", "postpone"]
    assert end.no_front == "no process to be had"
    front.is_due = True
    end.supervise_front(2.0)
    assert capfd.readouterr().err == (  # once a reason: nobody else could tell it
        "twind: no client can be served, the front cannot be started: no process to be had\n"
    )
    front.is_due = True
    front.cannot_start = False
    end.supervise_front(3.0)
    assert end.no_front == ""


def test_pending_replies_are_delivered_at_the_end(front: Front, end: FrontLink) -> None:
    end.reply(reply(1))
    end.close()
    assert front.said == ["finish"]
    assert [news.ticket for news in front.news()] == [1]


def test_a_living_front_is_left_alone(front: Front, end: FrontLink) -> None:
    for now in range(10):
        end.supervise_front(float(now))
    assert front.said == []
    assert not end.lost


def test_a_command_forwarded_before_the_death_of_a_front_is_still_executed(
    front: Front, end: FrontLink
) -> None:
    front.outer.send(link.encode(link.EStop(ticket=1, client=2, level="cut")))
    front.has_ended = True
    end.supervise_front(1.0)
    assert end.lost
    assert [each.command.level for each in end.commands(1.01)] == ["cut"]
    assert end.commands(1.02) == []


def test_a_command_of_the_tick_in_which_a_hung_front_is_killed_is_still_executed(
    front: Front, end: FrontLink
) -> None:
    front.send(link.EStop(ticket=1, client=2))
    front.is_overdue = True
    end.supervise_front(1.0)
    assert front.socket is None and end.lost
    assert [type(each.command) for each in end.commands(1.01)] == [link.EStop]


@pytest.mark.parametrize("gone", ["has_ended", "is_overdue"])
def test_an_e_stop_behind_a_flood_of_a_front_that_died_or_is_killed_is_still_executed(
    front: Front, end: FrontLink, gone: str
) -> None:
    for ticket in range(PER_TICK + 60):
        front.send(cancel(ticket))
    front.send(link.EStop(ticket=999, client=2))
    setattr(front, gone, True)
    end.supervise_front(1.0)
    taken = end.commands(1.01)
    assert len(taken) == PER_TICK + 61
    assert isinstance(taken[-1].command, link.EStop)


def test_a_crash_recording_is_released_on_request_of_the_front_and_that_is_not_recorded(
    front: Front,
) -> None:
    recorded: list[bytes] = []
    end = FrontLink(front, lambda _, data: recorded.append(data))  # type: ignore[arg-type]
    front.wreck = RecordingStandIn()  # type: ignore[attr-defined]
    end.supervise_front(1.0)
    front.send(link.Heartbeat())
    assert end.commands(2.0) == []
    assert front.wreck.dones == 0  # type: ignore[attr-defined]
    front.send(link.CrashRecordingDone())
    assert end.commands(3.0) == []
    assert front.wreck.dones == 1  # type: ignore[attr-defined]
    assert front.said[-1] == "alive at 3"
    assert recorded == []


@pytest.fixture
def bound(front: Front, tmp_path: Path) -> Iterator[tuple[Listener, list[tuple[str, Listener]]]]:
    """A socket that a front bound again, and what the loop keeps."""
    kept: list[tuple[str, Listener]] = []
    front.rebound = lambda name, listener: kept.append((name, listener))  # type: ignore[attr-defined]
    made = Listener.of(listen(tmp_path, "control"), own=True)
    yield made, kept
    for listener in (made, *(each for _, each in kept)):
        listener.close()


def test_a_socket_that_the_front_bound_again_is_kept_with_its_file_and_not_recorded(
    front: Front, bound: tuple[Listener, list[tuple[str, Listener]]]
) -> None:
    recorded: list[bytes] = []
    end = FrontLink(front, lambda _, data: recorded.append(data))  # type: ignore[arg-type]
    made, kept = bound
    assert front.outer is not None
    message = link.encode(link.Rebound(name="control", label=made.label))
    socket.send_fds(front.outer, [message], [made.bound.fileno()])
    assert end.commands(1.0) == []
    ((name, listener),) = kept
    assert (name, listener.label, listener.in_place) == ("control", made.label, True)
    assert not listener.bound.get_inheritable()
    assert recorded == []


@pytest.mark.parametrize(
    ("name", "label", "count"),
    [("control", "own:1:2", 0), ("other", "own:1:2", 1), ("control", "own:x:2", 1)],
)
def test_a_front_that_sends_no_socket_of_a_known_name_is_ended(
    front: Front, bound: tuple[Listener, list[tuple[str, Listener]]], name: str, label: str, count: int
) -> None:
    end = FrontLink(front)  # type: ignore[arg-type]
    made, kept = bound
    assert front.outer is not None
    fds = [made.bound.fileno()] * count
    before = len(os.listdir("/proc/self/fd"))
    socket.send_fds(front.outer, [link.encode(link.Rebound(name=name, label=label))], fds)
    assert end.commands(1.0) == []
    assert kept == [] and "end" in front.said
    assert len(os.listdir("/proc/self/fd")) <= before
