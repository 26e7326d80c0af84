"""A recording played back comes out as it was: golden captures under a fake clock, and what must not pass.

`tests/support/golden_captures.py` made them; times of faults may differ by one round of the slow registers.
"""

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.support.daemon_rig import CLIENT, Rig
from tests.support.golden_captures import HERE, LARGEST, cut, expected, expected_figures, names
from tests.support.replay_rig import Replay, flight, recording, unlike
from twind import link
from twind.flight import EntryKind, FlightContents, FlightEntry, LoadedFlight, load
from twind.observe.replaying.replay_bus import ReplayBus, reach
from twind.observe.replaying.replay_outcome import (
    CommandOutcome,
    RunOutcome,
    differences,
    uncompared,
)
from twind.observe.replaying.replay_script import score
from twind.robot.modes import Mode
from twind_drivers.dynamixel import packet

ROUND = 0.06  # s: torque, hardware error and watchdog are read twenty times a second


def played(recorded: LoadedFlight, folder: Path) -> RunOutcome:
    with closing(Replay(recorded, folder)) as replay:
        return replay.run()


def found(wanted: RunOutcome, recorded: LoadedFlight, folder: Path) -> list[str]:
    return list(differences(wanted, played(recorded, folder), ROUND))


def golden(name: str, folder: Path) -> list[str]:
    """All in which the replay of a capture is not as it must be."""
    with closing(Replay(load(HERE / f"{name}.flight"), folder)) as replay:
        wrong = list(differences(expected(name), replay.run(), ROUND))
        wanted = expected_figures(name)
        if replay.verbatim < wanted["verbatim"]:
            wrong.append(f"verbatim {replay.verbatim:.2f}, at least {wanted['verbatim']}")
        return wrong + list(unlike(wanted, replay.figures()))


@pytest.mark.parametrize("name", names())
def test_a_golden_capture_comes_out_as_it_was(name: str, tmp_path: Path) -> None:
    assert (HERE / f"{name}.flight").stat().st_size < LARGEST
    assert golden(name, tmp_path) == []


def test_without_the_recorded_bytes_a_golden_capture_does_not_come_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(ReplayBus, "_find", lambda *_: None)
    noise = golden("noise", tmp_path)
    assert [each.split()[0] for each in noise] == ["verbatim", "errors"], noise


@pytest.mark.parametrize(
    ("times", "far"),
    [
        ([1.00, 1.01, 1.02], 0.006),  # of every tick: no reply of another tick
        ([1.00, 1.10, 1.30], 0.045),  # of a slow register: nearer to this one than to the next
        ([1.00, 2.00, 3.00], ROUND),
        ([2.00], ROUND),
    ],
)
def test_a_question_asked_seldom_is_found_further_from_its_recorded_time(
    times: list[float], far: float
) -> None:
    assert reach(times, len(times) // 2, 0.006) == pytest.approx(far)


# ------------------------------------------------------------------------------------------- broken ones


def changed(
    recorded: LoadedFlight, entries: tuple[FlightEntry, ...] | None = None, **kept: Any
) -> LoadedFlight:
    contents = recorded.contents
    return replace(
        recorded, contents=FlightContents(kept.get("kept", contents.kept), entries or contents.entries)
    )


def test_a_single_invented_alert_is_found_in_the_replay(tmp_path: Path) -> None:
    """One error byte of one answer, its CRC made to fit."""
    recorded = load(HERE / "noise.flight")
    entries = list(recorded.contents.entries)
    late = entries[len(entries) // 2].time
    place = next(
        place
        for place, each in enumerate(entries)
        if each.kind == EntryKind.IN
        and each.time > late
        and each.data[4:5] == b"\xfe"
        and _healthy(each.data)
    )
    entries[place] = entries[place]._replace(data=_alert(entries[place].data))
    broken = found(expected("noise"), changed(recorded, tuple(entries)), tmp_path)
    assert any("SERVO_ALERT" in each for each in broken), broken


def _rows(data: bytes) -> list[tuple[int, int, bytes]]:
    """(error, id, data) of a fast answer of 10 bytes of each."""
    return [(data[at], data[at + 1], data[at + 2 : at + 12]) for at in range(8, len(data) - 13, 14)]


def _healthy(data: bytes) -> bool:
    promised = int.from_bytes(data[5:7], "little")
    return promised == 24 * 14 + 1 and b"".join(packet.fast_status(_rows(data), promised)) == data


def _alert(data: bytes) -> bytes:
    (_, id, first), *others = _rows(data)
    return b"".join(packet.fast_status([(packet.ALERT, id, first), *others], 24 * 14 + 1))


def test_a_single_damaged_identification_byte_is_found_in_the_replay(tmp_path: Path) -> None:
    """That servo does not answer then, or a stand-in with other settings answers in its place."""
    recorded = load(HERE / "limit.flight")
    entries = list(recorded.contents.kept[0])
    model = packet.status(1, 0, b"")[:5]
    spoilt = [
        each._replace(data=each.data.replace(model, model[:-1] + b"\xfd"))
        if each.kind == EntryKind.IN and len(each.data) > 60
        else each
        for each in entries
    ]
    assert spoilt != entries
    with pytest.raises(AssertionError, match=r"DEVICE_MISSING|nothing answers as id 1|CALIB_MISMATCH"):
        found(expected("limit"), changed(recorded, kept={0: tuple(spoilt)}), tmp_path)


def test_a_fault_that_is_not_expected_and_one_that_is_missing_are_found(tmp_path: Path) -> None:
    wanted = expected("silent")
    recorded = load(HERE / "silent.flight")
    replayed = played(recorded, tmp_path)
    assert list(differences(wanted, replayed, ROUND)) == []
    firsts = tuple(replace(each, findings=each.findings[:1]) for each in wanted.answers)
    for changed_field, difference in (
        ({"faults": {**wanted.faults, ("OVERCURRENT", "l_knee"): 1.0}}, "OVERCURRENT l_knee"),
        ({"faults": {}}, "was not recorded"),
        ({"faults": {key: time + 0.1 for key, time in wanted.faults.items()}}, "from that"),
        ({"answers": firsts}, "command"),
        ({"armed": False}, "armed"),
    ):
        other: RunOutcome = replace(wanted, **changed_field)
        assert any(difference in each for each in differences(other, replayed, ROUND)), difference


def test_an_incomplete_command_is_compared_as_far_as_it_goes() -> None:
    def with_answer(**fields: Any) -> RunOutcome:
        return RunOutcome((CommandOutcome("SubmitTrajectory", **fields),), {}, "armed", "live", True)

    def same(then: RunOutcome, now: RunOutcome) -> bool:
        return not list(differences(then, now, 0.1))

    running = with_answer(phase="running")
    ended = with_answer(phase="succeeded")
    assert same(running, ended) and same(with_answer(answered=False), ended)
    assert not same(ended, running) and not same(running, with_answer(error="Refused"))
    assert not same(ended, with_answer(answered=False))
    aborted = with_answer(phase="aborted")
    refused = with_answer(error="Refused")
    assert "running" in next(uncompared(running, aborted))
    assert "Refused" in next(uncompared(with_answer(answered=False), refused))
    assert not list(uncompared(ended, ended)) and not list(uncompared(running, running))


# ------------------------------------------------------------------------------------------- other scenes


def moved(rig: Rig) -> None:
    rig.lease()
    rig.submit(rig.path("head_yaw", [0.0, 0.3], [0.5, 2.0]), more=True)


def rebooted(rig: Rig) -> None:
    """A servo restarts by itself."""
    moved(rig)
    rig.seconds(0.8)
    next(iter(rig.virtual.values())).faults.brown_out(id=1)
    rig.seconds(1.0)


def half_unplugged(rig: Rig) -> None:
    """One of two buses goes and comes back."""
    moved(rig)
    rig.seconds(0.5)
    bus = list(rig.virtual.values())[-1]
    bus.faults.unplug()
    rig.seconds(0.7)
    bus.faults.replug()
    rig.seconds(1.0)
    moved(rig)
    rig.seconds(0.2)


def streamed(rig: Rig) -> None:
    """Setpoints, the last one beyond a limit."""
    rig.lease()
    joint = rig.names.index("head_yaw")
    for step in range(20):
        rig.send(link.Setpoint, joints=[joint], positions=[0.005 * step])
        rig.ticks(2)
    rig.send(link.Setpoint, joints=[joint], positions=[9.0])
    rig.seconds(0.5)


@pytest.mark.parametrize(
    ("robot", "scene"), [("h24", rebooted), ("h24-split", half_unplugged), ("h24", streamed)]
)
@pytest.mark.parametrize("from_the_middle", [False, True])
def test_a_replayed_recording_gives_the_recorded_outcome(
    robot: str, scene: Callable[[Rig], None], from_the_middle: bool, tmp_path: Path
) -> None:
    """From its identification on, and where that was long before."""
    rig = recording(robot)
    rig.arm()
    armed = rig.clock.now()
    rig.seconds(0.3)
    scene(rig)
    whole = flight(rig, tmp_path)
    rig.close()
    recorded = cut(whole, armed + 0.1) if from_the_middle else whole
    asked = score(recorded)
    assert asked.armed == from_the_middle
    assert asked.recorded.answers
    replay = Replay(recorded, tmp_path / "replay")
    assert list(differences(asked.recorded, replay.run(), ROUND)) == []
    assert all(bus.verbatim > 100 for bus in replay.told.values())
    replay.close()


def test_checks_without_recorded_arrays_are_skipped_and_reported_once(tmp_path: Path) -> None:
    rig = recording()
    rig.arm()
    rig.seconds(0.3)
    for _ in range(3):
        rig.submit(rig.path("head_yaw", [0.0, 0.3], [0.5, 2.0]), check_only=True)
    moved(rig)
    rig.seconds(0.2)
    found = score(flight(rig, tmp_path))
    rig.close()
    assert found.left_out == ("3 of Check: points were not recorded",) and found.whole
    assert [each.method for each in found.commands][-1] == "SubmitTrajectory"


def hang_up(rig: Rig) -> None:
    rig.front.outer.send(link.encode(link.ConnectionClosed(client=CLIENT)))
    rig.seconds(0.1)


def test_a_client_that_left_after_all_replies_waits_for_later_ones_in_the_replay(tmp_path: Path) -> None:
    """A motion that begins two ticks later ends two ticks later; `twindctl move` hangs up after it."""
    rig = recording()
    rig.arm()
    rig.seconds(0.3)
    ticket = rig.submit(rig.path("head_yaw", [0.0, 0.1], [0.3, 0.8]), more=True)
    while not any(not each.continues for each in rig.replies(ticket)):
        rig.ticks(1)
    hang_up(rig)
    recorded = flight(rig, tmp_path)
    later = 2.0 * rig.loop.robot.period
    rig.close()
    asked = score(recorded)
    assert asked.recorded.answers[-1].phase == "succeeded" and asked.heard[CLIENT][ticket]
    begun = next(each.time for each in asked.asked if isinstance(each.command, link.Submit))
    moved = [
        each._replace(time=begun + later)
        if each.kind in (EntryKind.COMMAND, EntryKind.ARRAYS) and begun <= each.time < begun + later
        else each
        for each in recorded.contents.entries
    ]
    slower = changed(recorded, tuple(sorted(moved, key=lambda each: each.time)))
    assert found(asked.recorded, slower, tmp_path / "replay") == []


def test_replies_after_a_client_left_count_as_unanswered(tmp_path: Path) -> None:
    """A client that disconnects in a motion leaves its last reported phase; later calls stay unanswered."""
    rig = recording()
    rig.arm()
    front = link.RenewLease(ticket=0, client=CLIENT)  # which it sends of itself, for any client
    rig.front.outer.send(link.encode(front))
    moved(rig)
    rig.seconds(0.2)
    rig.front.outer.send(link.encode(link.RenewLease(ticket=0, client=CLIENT + 1)))
    disarmed = rig.send(link.Disarm)
    hang_up(rig)
    rig.seconds(2.0)
    assert rig.replies(disarmed), "the loop answers whoever is there"
    asked = score(flight(rig, tmp_path))
    rig.close()
    motion = next(each for each in asked.recorded.answers if each.method == "SubmitTrajectory")
    assert motion.phase == "running"
    open_ = [each.method for each in asked.recorded.answers if not each.answered]
    assert open_ == ["Disarm"]
    submitted = next(each.command.ticket for each in asked.commands if isinstance(each.command, link.Submit))
    assert asked.heard[CLIENT][submitted] is False and disarmed not in asked.heard[CLIENT]


@pytest.mark.parametrize("mode", [Mode.SIM, Mode.MIRROR])
def test_a_recording_of_the_simulation_replays_to_the_same_outcome(mode: Mode, tmp_path: Path) -> None:
    rig = recording(mode=mode)
    if mode is Mode.MIRROR:
        rig.connect()
    rig.seconds(0.5)
    moved(rig)
    rig.seconds(0.8)
    rig.lease()
    rig.submit(rig.path("head_yaw", [0.0, 9.0], [0.5, 2.0]))
    rig.call(link.Arm)
    rig.seconds(1.5)
    recorded = flight(rig, tmp_path)
    rig.close()
    wanted = score(recorded).recorded
    assert [each.findings[0][0] for each in wanted.answers if each.error] == ["POS_LIMIT", "MODE_DENIES"]
    assert found(wanted, recorded, tmp_path / "replay") == []


def test_imu_readings_and_their_absence_are_replayed(tmp_path: Path) -> None:
    with closing(recording("h24-standing", mode=Mode.MIRROR)) as rig:
        rig.connect()
        sensor = rig.virtual["main"].sensor
        sensor.err(gyro_bias=0.25)
        rig.seconds(1.0)
        rig.virtual["main"].faults.silence(sensor.id)
        rig.seconds(1.0)
        recorded = flight(rig, tmp_path)
    (tmp_path / "stage").mkdir()
    with closing(Replay(recorded, tmp_path / "stage")) as replay:
        replay.run()
        told = replay.loop.robot.measured.imu
        assert told is not None and told.gyro == pytest.approx([0.25] * 3, abs=0.001)
        assert 0.7 < replay.loop.robot.measured.time - told.time < 1.3
        assert replay.loop.robot.measured.heard.all()
