"""The flight recorder keeps all bytes of buses and link, and changes none of them."""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.daemon_rig import MakeRig, Rig
from twind import link
from twind.config.robot_file import load_robot
from twind.flight import NO_BUS, EntryKind, FlightContents, FlightEntry, FlightRing, read
from twind.loop.bus.bus_tap import MOST, SPAN, RecordingBusTap, TappedChannel, TappedTransport, size
from twind.robot.modes import Mode
from twind_drivers.bus import PortError, PortErrorCause
from twind_drivers.byte_transport import output_full
from twind_drivers.clock import FakeClock
from twind_drivers.dynamixel.packet import HEADER
from twind_drivers.ports.frame import FRAME


@pytest.fixture
def ring() -> Iterator[FlightRing]:
    ring = FlightRing.create(8 << 20, buses=3)
    yield ring
    ring.close()


def only(contents: FlightContents, *kinds: EntryKind, bus: int | None = None) -> list[FlightEntry]:
    return [each for each in contents.entries if each.kind in kinds and bus in (None, each.bus)]


def story(ring: FlightRing | None, robot: str = "h24") -> tuple[list[Any], list[np.ndarray]]:
    """Connected, armed, moved a joint, disarmed: what the front was told, and where every servo was."""
    rig = Rig(robot, ring=ring)
    rig.arm()
    places = [rig.truth]
    joint = rig.names[3]
    at = float(rig.loop.robot.measured.position[3])
    rig.submit(rig.path(joint, [at, at + 0.1], [0.0, 0.5]))
    for _ in range(10):
        rig.ticks(10)
        places.append(rig.truth)
    rig.call(link.Disarm, ticks=800)
    news = [link.encode(each) for each in rig.news]
    rig.close()
    return news, places


@pytest.mark.parametrize("robot", ["h24", "h24-mixed"])
def test_recording_changes_neither_events_nor_motion(ring: FlightRing, robot: str) -> None:
    news, places = story(None, robot)
    again, same = story(ring, robot)
    assert again == news
    assert all(np.array_equal(one, other) for one, other in zip(places, same, strict=True))
    assert ring.refused == 0


def test_the_news_of_the_link_are_those_that_were_sent(ring: FlightRing, make_rig: MakeRig) -> None:
    rig = make_rig(ring=ring)
    rig.arm()
    rig.ticks(20)
    told = [link.decode_news(each.data) for each in only(read(ring.fd), EntryKind.NEWS)]
    for kinds in ((link.Tick, link.Overview), (link.Event, link.Reply, link.VerdictReport)):
        written = [link.encode(each) for each in told if isinstance(each, kinds)]
        assert written == [link.encode(each) for each in rig.news if isinstance(each, kinds)]
        assert written
    assert all(
        each.bus == NO_BUS
        for each in only(read(ring.fd), EntryKind.NEWS, EntryKind.COMMAND, EntryKind.ARRAYS)
    )


def test_commands_are_written_down_as_they_were_taken_with_their_arrays_behind_them(
    ring: FlightRing, make_rig: MakeRig
) -> None:
    rig = make_rig(ring=ring)
    rig.arm()
    path = rig.path(rig.names[0], [0.0, 0.1], [0.2, 0.6])
    rig.front.outer.send(link.encode(link.Heartbeat()))
    rig.submit(path)
    rig.ticks(2)
    rig.front.outer.send(link.encode(link.ConnectionClosed(client=7)))
    rig.ticks(2)
    found = only(read(ring.fd), EntryKind.COMMAND, EntryKind.ARRAYS)
    kinds = [
        type(link.decode_command(each.data)).__struct_config__.tag
        for each in found
        if each.kind is EntryKind.COMMAND
    ]
    assert kinds == ["AcquireLease", "Arm", "Submit", "Gone"]
    place = [each.kind for each in found].index(EntryKind.ARRAYS)
    submit = link.decode_command(found[place - 1].data)
    assert isinstance(submit, link.Submit)
    again = link.unpack_path(found[place].data, submit, len(rig.names))
    assert np.array_equal(again.position, path.position)
    assert found[place].time <= rig.clock.now()


def test_a_check_is_recorded_without_its_arrays(ring: FlightRing, make_rig: MakeRig) -> None:
    rig = make_rig(ring=ring)
    rig.arm()
    for check_only in (True, False):
        rig.submit(rig.path(rig.names[0], [0.0, 0.1], [0.2, 0.6]), check_only=check_only)
        rig.ticks(2)
    found = only(read(ring.fd), EntryKind.COMMAND, EntryKind.ARRAYS)[-3:]
    assert [each.kind for each in found] == [EntryKind.COMMAND, EntryKind.COMMAND, EntryKind.ARRAYS]


def test_times_are_those_of_the_loop_and_never_go_back(ring: FlightRing, make_rig: MakeRig) -> None:
    rig = make_rig(ring=ring)
    before = rig.clock.now()
    rig.ticks(50)
    times = [each.time for each in read(ring.fd).entries]
    assert times == sorted(times)
    assert before <= times[0] <= times[-1] <= rig.clock.now()
    assert {round((time - before) / 0.01) for time in times} == set(range(50))


def test_both_directions_of_a_bus_are_there_byte_for_byte(
    ring: FlightRing, make_rig: MakeRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig(ring=ring)
    bus = rig.virtual["main"]
    out = []
    back = []
    receive = bus.receive
    take = bus.take

    def took(now: float) -> bytes:
        back.append(take(now))
        return bytes(back[-1])

    monkeypatch.setattr(bus, "take", took)
    monkeypatch.setattr(bus, "receive", lambda data, now: (out.append(data), receive(data, now))[1])
    rig.connect()
    bus.faults.delay(0.02, 5)  # late answers are thrown away by the driver, and written down all the same
    rig.ticks(30)
    contents = read(ring.fd)
    assert b"".join(each.data for each in only(contents, EntryKind.OUT, bus=0)) == b"".join(out)
    assert b"".join(each.data for each in only(contents, EntryKind.IN, bus=0)) == b"".join(back)
    assert [each.data for each in only(contents, EntryKind.OUT)] == out  # once a write


def test_frames_of_a_can_bus_are_there_as_their_records(ring: FlightRing, make_rig: MakeRig) -> None:
    rig = make_rig("h24-mixed", ring=ring)
    rig.connect()
    place = [port.name for port in rig.loop.hardware.ports].index(
        next(bus.name for bus in rig.robot.buses if bus.kind == "can")
    )
    contents = read(ring.fd)
    for kind in (EntryKind.OUT, EntryKind.IN):
        data = b"".join(each.data for each in only(contents, kind, bus=place))
        frames = np.frombuffer(data, FRAME)
        assert len(frames) > 100
        assert (frames["size"] <= 8).all()
    assert set(contents.kept) == {0, 1, 2}
    assert {each.kind for each in contents.kept[place]} == {EntryKind.OUT, EntryKind.IN}


def test_the_opening_and_loss_of_a_port_are_recorded(ring: FlightRing) -> None:
    rig = Rig(ring=ring)
    rig.connect()
    rig.virtual["main"].faults.unplug()
    rig.ticks(5)
    rig.virtual["main"].faults.replug()
    rig.seconds(1.0)
    said = [each.data.decode() for each in only(read(ring.fd), EntryKind.PORT, bus=0)]
    assert said[0] == "opened virtual:main"
    assert said[1].startswith("lost ")
    assert "virtual:main" in said[1]
    assert said[2] == "opened virtual:main"
    rig.loop.close()
    assert only(read(ring.fd), EntryKind.PORT, bus=0)[-1].data.startswith(b"lost ")


@pytest.mark.parametrize("mode", [Mode.SIM, Mode.MIRROR])
def test_every_mode_is_written_down(ring: FlightRing, make_rig: MakeRig, mode: Mode) -> None:
    rig = make_rig(mode=mode, ring=ring)
    rig.lease()
    rig.ticks(20)
    contents = read(ring.fd)
    assert len(only(contents, EntryKind.NEWS)) > 20
    assert len(only(contents, EntryKind.COMMAND)) == 1
    assert bool(only(contents, EntryKind.OUT)) == (mode is Mode.MIRROR)


# --------------------------------------------------------------------------------------- identification


def test_the_last_identification_of_a_bus_is_kept_whole(ring: FlightRing, make_rig: MakeRig) -> None:
    rig = make_rig(ring=ring)
    rig.connect()
    rig.ticks(100)
    first = read(ring.fd).kept[0]
    heard = b"".join(each.data for each in first if each.kind is EntryKind.IN)
    assert heard.count(HEADER) > 24
    assert (
        list(first) == only(read(ring.fd), EntryKind.OUT, EntryKind.IN, bus=0)[: len(first)]
    )  # from the first byte
    connected = next(event.time for event in rig.events("connected"))
    assert connected - rig.loop.robot.period <= first[-1].time <= connected  # to the last
    rig.loop.hardware.ports[0].identify()
    rig.ticks(100)
    assert read(ring.fd).kept[0][0].time > first[-1].time


def test_an_incomplete_identification_does_not_replace_a_complete_one_in_the_ring(
    ring: FlightRing, make_rig: MakeRig
) -> None:
    rig = make_rig(ring=ring)
    rig.connect()
    whole = read(ring.fd).kept[0]
    rig.virtual["main"].faults.silence(3)
    rig.loop.hardware.ports[0].identify()
    rig.seconds(2.0)
    assert rig.loop.identity.missing["main"]
    assert read(ring.fd).kept[0] == whole


def test_an_identification_incomplete_from_the_start_is_kept_in_the_ring(
    ring: FlightRing, make_rig: MakeRig
) -> None:
    rig = make_rig(ring=ring)
    rig.virtual["main"].faults.silence(3)
    rig.seconds(2.0)
    assert rig.loop.identity.missing["main"]
    assert len(read(ring.fd).kept[0]) > 24
    rig.virtual["main"].faults.silence(3, False)
    rig.seconds(2.0)
    connected = next(event.time for event in rig.events("connected"))
    assert connected - rig.loop.robot.period <= read(ring.fd).kept[0][-1].time <= connected


def test_a_transcript_that_a_babbler_made_too_long_is_not_kept(ring: FlightRing) -> None:
    tape = RecordingBusTap(ring, 0, FakeClock(1.0))
    tape.identifying()
    for _ in range(70):
        tape.record_received(bytes(4096))
    tape.identified(whole=True)
    assert read(ring.fd).kept == {}
    tape.identifying()
    tape.sent(b"who?")
    tape.identified(whole=True)
    assert read(ring.fd).kept == {0: (FlightEntry(1.0, EntryKind.OUT, 0, b"who?"),)}


# --------------------------------------------------------------------------------------- the port beneath


class Wire:
    """A transport in our hands."""

    def __init__(self) -> None:
        self.name = "wire"
        self.warning = ""
        self.holds = True
        self.left = b""
        self.broken = False
        self.last = 4096

    def fileno(self) -> int:
        return 5

    def arrival(self) -> float:
        return 1.5

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self._check()

    def read_into(self, buffer: memoryview) -> int:
        self._check()
        count = min(len(buffer), len(self.left))
        buffer[:count] = self.left[:count]
        self.left = self.left[count:]
        return count

    def settle(self) -> None:
        pass

    def drain(self, thrown: bytearray | None = None) -> int:
        count = len(self.left)
        gone = self.left[-self.last :]
        self.left = b""
        if thrown is not None:
            thrown[:] = gone if len(gone) < count else thrown + gone
        return count

    def backlog(self) -> int:
        return 3

    def flush(self) -> None:
        self.left = b""

    def close(self) -> None:
        self.broken = True

    def _check(self) -> None:
        if self.broken:
            raise PortError("wire", "gone", kind=PortErrorCause.LOST)


@pytest.mark.parametrize("last", [4096, 10])
@pytest.mark.parametrize("before", [b"", b"late"])
def test_a_taped_port_answers_as_the_one_inside(ring: FlightRing, last: int, before: bytes) -> None:
    plain = Wire()
    inside = Wire()
    plain.last = inside.last = last
    taped = TappedTransport(inside, RecordingBusTap(ring, 0, FakeClock(1.0)))
    assert (taped.name, taped.holds, taped.fileno(), taped.arrival(), taped.backlog()) == (
        "wire",
        True,
        5,
        1.5,
        3,
    )
    inside.warning = "slow"
    assert taped.warning == "slow"
    taped.warning = "slower"
    assert inside.warning == "slower"
    for one in (plain, taped):
        one.write(b"ask")
    plain.left = inside.left = bytes(range(50))
    results = []
    for one in (plain, taped):
        buffer = bytearray(20)
        thrown = bytearray(before)
        count = one.read_into(memoryview(buffer))
        results.append(
            (
                count,
                bytes(buffer),
                one.drain(thrown),
                bytes(thrown),
                one.drain(),
                one.read_into(memoryview(buffer)),
            )
        )
    assert results[0] == results[1]
    found = [(each.kind, each.data) for each in read(ring.fd).entries]
    end = bytes(range(50))[20:][-last:]
    assert found == [(EntryKind.OUT, b"ask"), (EntryKind.IN, bytes(range(20))), (EntryKind.IN, end)]


def test_a_write_refused_by_a_port_is_recorded_with_its_cause(ring: FlightRing) -> None:
    inside = Wire()
    taped = TappedTransport(inside, RecordingBusTap(ring, 0, FakeClock(1.0)))
    taped.close()
    with pytest.raises(PortError, match="gone"):
        taped.write(b"ask")
    with pytest.raises(PortError, match="gone"):
        taped.read_into(memoryview(bytearray(4)))
    found = [(each.kind, each.data) for each in read(ring.fd).entries]
    assert found == [(EntryKind.PORT, b"refused 3 bytes: wire: gone")]


def test_a_write_refused_by_a_can_channel_is_recorded_with_its_cause(ring: FlightRing) -> None:
    def full(_frames: Any, _now: float) -> None:
        raise output_full("can0", 90, 64)

    nothing = lambda *_: None  # noqa: E731
    inside: Any = SimpleNamespace(name="can0", condition=nothing, fileno=nothing, arrival=nothing)
    inside.close = inside.drive = inside.purge = nothing
    inside.send = full
    taped = TappedChannel(inside, RecordingBusTap(ring, 1, FakeClock(1.0)))
    with pytest.raises(PortError):
        taped.send(np.zeros(2, FRAME), 1.0)
    (entry,) = read(ring.fd).entries
    assert (entry.kind, entry.bus) == (EntryKind.PORT, 1)
    assert entry.data.startswith(b"refused %d bytes: can0: " % (2 * FRAME.itemsize))


def test_bytes_discarded_before_a_port_loss_are_recorded(ring: FlightRing) -> None:
    inside = Wire()

    def gone(thrown: bytearray | None = None) -> int:
        assert thrown is not None
        thrown += b"late"
        raise PortError("wire", "gone", kind=PortErrorCause.LOST)

    inside.drain = gone  # type: ignore[method-assign]
    taped = TappedTransport(inside, RecordingBusTap(ring, 0, FakeClock(1.0)))
    with pytest.raises(PortError, match="gone"):
        taped.drain()
    assert [(each.kind, each.data) for each in read(ring.fd).entries] == [(EntryKind.IN, b"late")]


# --------------------------------------------------------------------------------------- how much


@pytest.mark.parametrize("share", [5, pytest.param(1, marks=pytest.mark.campaign)])
def test_half_a_minute_fits_and_no_robot_takes_more_than_its_share(share: int) -> None:
    """A part of the memory holds the same part of the time."""
    ring = FlightRing.create(size(load_robot("h24"), 100.0) // share)
    rig = Rig(ring=ring)
    rig.arm()
    joint = rig.names[3]
    at = float(rig.loop.robot.measured.position[3])
    rig.submit(rig.path(joint, [at, at + 0.2] * 20, [0.5 * i for i in range(40)]))
    rig.seconds(32.0 / share)
    entries = read(ring.fd).entries
    assert entries[-1].time - entries[0].time >= SPAN / share
    rig.close()
    ring.close()
    assert size(load_robot("h24"), 100.0) < 20 << 20
    assert size(load_robot("h24-split"), 1000.0) <= MOST
