"""A recording played back comes out as it was: golden captures under a fake clock, and what must not pass.

`tests/captures.py` made them; times of faults may differ by one round of the slow registers.
"""

import json
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from captures import HERE, LARGEST, STATES, cut, expected, expected_figures, names
from replayed import Replay, flight, recording, unlike
from rig import Rig

from twind import link
from twind.briefing import Briefing
from twind.ctl.main import main
from twind.ctl.verb import DONE, REFUSED, USAGE
from twind.flight import Contents, Entry, Flight, Kind, load, save
from twind.observe import replay, viewing
from twind.observe.recording import open_recording
from twind.observe.replaying.bus import ToldBus
from twind.observe.replaying.calls import call
from twind.observe.replaying.outcome import Answer, Outcome, differences, outcome_of, uncompared
from twind.observe.replaying.score import Unplayable, score
from twind.observe.replaying.shown import messages
from twind.observe.replaying.stage import lay_out
from twind.robot.modes import Mode
from twind_drivers.clock import FakeClock
from twind_drivers.dynamixel import packet

ROUND = 0.06  # s: torque, hardware error and watchdog are read twenty times a second


def played(recorded: Flight, folder: Path) -> Outcome:
    with closing(Replay(recorded, folder)) as replay:
        return replay.run()


def found(wanted: Outcome, recorded: Flight, folder: Path) -> list[str]:
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
    monkeypatch.setattr(ToldBus, "_find", lambda *_: None)
    noise = golden("noise", tmp_path / "noise")
    assert [each.split()[0] for each in noise] == ["verbatim", "errors"], noise
    silent = golden("silent", tmp_path / "silent")
    assert [each.split()[0] for each in silent] == ["verbatim"], silent


def test_the_captures_hold_what_they_are_for() -> None:
    refusals = {name: [each.findings for each in expected(name).answers if each.error] for name in names()}
    assert {code for code, _ in refusals["limit"][0]} == {"POS_LIMIT", "BRAKE_DISTANCE"}
    assert ("FAULT_LATCHED", None) in refusals["silent"][0]
    assert ("STATE_STALE", "l_shoulder_pitch") in expected("silent").faults
    assert ("SERVO_ALERT", "head_yaw") in expected("overload").faults
    assert ("ESTOP_LATCHED", None) in refusals["estop"][0]
    assert ("FAULT_LATCHED", None) in refusals["unplug"][0]
    assert refusals["noise"] == [] and not expected("noise").faults


# ------------------------------------------------------------------------------------------- broken ones


def changed(recorded: Flight, entries: tuple[Entry, ...] | None = None, **kept: Any) -> Flight:
    contents = recorded.contents
    return replace(recorded, contents=Contents(kept.get("kept", contents.kept), entries or contents.entries))


def test_one_alert_that_was_not_there_is_found(tmp_path: Path) -> None:
    """One error byte of one answer, its CRC made to fit."""
    recorded = load(HERE / "noise.flight")
    entries = list(recorded.contents.entries)
    late = entries[len(entries) // 2].time
    place = next(
        place
        for place, each in enumerate(entries)
        if each.kind == Kind.IN and each.time > late and each.data[4:5] == b"\xfe" and _healthy(each.data)
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


def test_one_broken_byte_of_an_identification_is_found(tmp_path: Path) -> None:
    """Nobody knows then what that servo is."""
    recorded = load(HERE / "limit.flight")
    entries = list(recorded.contents.kept[0])
    model = packet.status(1, 0, b"")[:5]
    spoilt = [
        each._replace(data=each.data.replace(model, model[:-1] + b"\xfd"))
        if each.kind == Kind.IN and len(each.data) > 60
        else each
        for each in entries
    ]
    assert spoilt != entries
    with pytest.raises(AssertionError, match=r"DEVICE_MISSING|nothing answers as id 1"):
        found(expected("limit"), changed(recorded, kept={0: tuple(spoilt)}), tmp_path)


def test_a_fault_that_is_not_expected_and_one_that_is_missing_are_found(tmp_path: Path) -> None:
    wanted = expected("silent")
    recorded = load(HERE / "silent.flight")
    replayed = played(recorded, tmp_path)
    assert list(differences(wanted, replayed, ROUND)) == []
    more = replace(wanted, faults={**wanted.faults, ("OVERCURRENT", "l_knee"): 1.0})
    assert any("OVERCURRENT l_knee" in each for each in differences(more, replayed, ROUND))
    assert any(
        "was not recorded" in each for each in differences(replace(wanted, faults={}), replayed, ROUND)
    )
    other = tuple(replace(each, findings=each.findings[:1]) for each in wanted.answers)
    assert any("command" in each for each in differences(replace(wanted, answers=other), replayed, ROUND))
    late = replace(wanted, faults={key: time + 0.1 for key, time in wanted.faults.items()})
    assert any("from that" in each for each in differences(late, replayed, ROUND))
    assert any("armed" in each for each in differences(replace(wanted, armed=False), replayed, ROUND))


def test_an_outcome_survives_its_file() -> None:
    wanted = expected("overload")
    assert outcome_of(json.loads(json.dumps(wanted.plain()))) == wanted


def test_what_is_not_told_to_its_end_is_compared_as_far_as_it_goes() -> None:
    def with_answer(**fields: Any) -> Outcome:
        return Outcome((Answer("SubmitTrajectory", **fields),), {}, "armed", "live", True)

    def same(then: Outcome, now: Outcome) -> bool:
        return not list(differences(then, now, 0.1))

    running, ended = with_answer(phase="running"), with_answer(phase="succeeded")
    assert same(running, ended) and same(with_answer(answered=False), ended)
    assert not same(ended, running) and not same(running, with_answer(error="Refused"))
    assert not same(ended, with_answer(answered=False))
    aborted, refused = with_answer(phase="aborted"), with_answer(error="Refused")
    assert "running" in next(uncompared(running, aborted))
    assert "Refused" in next(uncompared(with_answer(answered=False), refused))
    assert not list(uncompared(ended, ended)) and not list(uncompared(running, running))


def told(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, **changes: Any
) -> tuple[int, str]:
    """What the verb makes of a replay in which nothing differs."""
    asked = score(load(HERE / "limit.flight"))
    verbatim, missed = changes.pop("verbatim", 0.7), changes.pop("missed", 0)
    asked = replace(asked, **changes)
    outcome = expected("limit")
    monkeypatch.setattr(replay, "_play", lambda *_, **__: replay.Played(asked, outcome, verbatim, missed))
    return run(capsys, str(HERE / "limit.flight"))


def test_the_same_is_said_only_of_what_was_played(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    code, text = told(capsys, monkeypatch)
    assert code == DONE and "replayed: the same" in text and "time for every tick" in text
    code, text = told(capsys, monkeypatch, missed=3)
    assert code == DONE and "no time for 3 ticks" in text
    code, text = told(capsys, monkeypatch, verbatim=0.0)
    assert code == REFUSED and "the same (" not in text and "no question had its recorded answer" in text
    code, text = told(capsys, monkeypatch, whole=False, left_out=("a reload",))
    assert code == REFUSED and "the same (" not in text and "not all was asked again" in text
    recorded = expected("limit")
    first = replace(recorded.answers[0], answered=False)
    code, text = told(capsys, monkeypatch, recorded=replace(recorded, answers=(first, *recorded.answers[1:])))
    assert code == DONE and "not compared, 1:" in text and "command 1" in text


def test_what_a_file_says_moves_no_cursor(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    code, text = told(capsys, monkeypatch, left_out=("\x1b[2Jreplayed\nreplayed: different",))
    assert code == DONE and "\x1b" not in text
    assert not any(line.startswith("replayed: different") for line in text.splitlines())


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
def test_what_a_loop_recorded_comes_out_of_another_one(
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


def test_fewer_states_tell_the_same(tmp_path: Path) -> None:
    rig = recording()
    rig.arm()
    moved(rig)
    rig.seconds(2.5)
    whole = flight(rig, tmp_path)
    rig.close()
    thin = cut(whole, 0.0)
    assert len(thin.contents.entries) < len(whole.contents.entries)
    assert score(thin).recorded.plain() == score(whole).recorded.plain()
    assert STATES > 1


def test_checks_of_which_nothing_moved_are_not_asked_again_and_that_is_said_once(tmp_path: Path) -> None:
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


# ------------------------------------------------------------------------------------------- what cannot be


def test_a_recording_without_a_moment_of_rest_says_so() -> None:
    recorded = load(HERE / "silent.flight")
    begin = recorded.contents.entries[-1].time - 0.5
    with pytest.raises(Unplayable, match=r"no moment to begin at: .* fault.*--view"):
        score(cut(recorded, begin))


def test_the_files_of_a_recording_stay_in_their_folder(tmp_path: Path) -> None:
    briefing = load(HERE / "limit.flight").briefing
    assert not briefing.binding and not briefing.described, "nothing that would have to be unpickled"
    evil = {"/../../etc/evil": "x", "../up": "y", "/a/../../b": "z"}
    placed = msgspec.structs.replace(briefing, texts={**briefing.texts, **evil})
    folder = tmp_path / "inner"
    folder.mkdir()
    files = lay_out(placed, folder)
    written = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert len(written) == len(placed.texts) + 1
    assert all(path.resolve().is_relative_to(folder) for path in written)
    assert files.robot.is_relative_to(folder)


def with_buses(briefing: Briefing, *names: str) -> Briefing:
    """Told to have had these buses, whatever its robot file says."""
    (bus,) = briefing.description["buses"]
    described = {**briefing.description, "buses": [{**bus, "name": name} for name in names]}
    return msgspec.structs.replace(briefing, description=described)


@pytest.mark.parametrize(
    "names", [("main", "extra"), (), ("../../victim",), ("/tmp/victim",), ("main", "main")]
)
def test_a_robot_file_with_other_buses_than_were_recorded_is_refused(
    names: tuple[str, ...], tmp_path: Path
) -> None:
    """A bus that is not played would keep the port of the file: one of this machine."""
    with pytest.raises(Unplayable, match=r"recorded were .*--robot FILE"):
        lay_out(with_buses(load(HERE / "limit.flight").briefing, *names), tmp_path)


@pytest.mark.parametrize("named", [False, True])
def test_a_bus_that_was_not_recorded_never_opens_the_port_of_its_file(named: bool, tmp_path: Path) -> None:
    """In the recorded file, and in one that is named instead."""
    briefing = load(HERE / "limit.flight").briefing
    path = briefing.description["path"]
    more = briefing.texts[path].replace(
        "buses:\n", "buses:\n  extra: {kind: dynamixel2, port: /dev/ttyUSB7, baud: 1000000}\n"
    )
    assert more != briefing.texts[path]
    spoilt = msgspec.structs.replace(briefing, texts={**briefing.texts, path: more})
    folder = tmp_path / "replay"
    folder.mkdir()
    other = None
    if named:
        kept = tmp_path / "kept"
        kept.mkdir()
        other = lay_out(briefing, kept).robot
        other.write_text(more)
        spoilt = briefing
    with pytest.raises(Unplayable, match="extra"):
        lay_out(spoilt, folder, other)


def test_names_of_buses_are_no_paths(tmp_path: Path) -> None:
    """A port of the replay hides no file of the user's."""
    victim = tmp_path / "victim"
    victim.write_text("mine")
    recorded = load(HERE / "limit.flight")
    recorded = replace(recorded, briefing=with_buses(recorded.briefing, str(victim)))
    path = tmp_path / "evil.flight"
    save(path, {}, msgspec.msgpack.encode(recorded.briefing), recorded.contents)
    assert main(["replay", str(path)]) == REFUSED
    assert victim.read_text() == "mine" and not victim.is_symlink()


def test_a_recording_without_its_robot_says_how_to_name_it(tmp_path: Path) -> None:
    briefing = msgspec.structs.replace(load(HERE / "limit.flight").briefing, texts={})
    with pytest.raises(Unplayable, match="--robot FILE"):
        lay_out(briefing, tmp_path)


def test_a_call_has_the_names_and_numbers_of_its_command() -> None:
    recorded = load(HERE / "limit.flight")
    asked = score(recorded)
    submits = [each for each in asked.commands if isinstance(each.command, link.Submit)]
    method, parameters, more = call(submits[0], asked.names)
    assert (method, more) == ("SubmitTrajectory", True)
    assert parameters["trajectory"]["joint_names"] == ["head_yaw"]
    (point,) = parameters["trajectory"]["points"]
    assert point == {"positions": [4.0], "velocities": [0.0], "time_from_start": 3.0}
    lease = next(each for each in asked.commands if isinstance(each.command, link.AcquireLease))
    assert call(lease, asked.names)[:2] == ("AcquireLease", {"take": False})
    assert np.isfinite(asked.goal).all()


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    code = main(["replay", *arguments])
    told = capsys.readouterr()
    return code, told.out + told.err


def test_what_is_no_flight_file_is_refused_in_words(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    code, told = run(capsys, str(tmp_path / "run.mcap"))
    assert code == USAGE and "no bytes" in told and "--view" in told
    other = tmp_path / "other.flight"
    other.write_bytes(b"something else")
    code, told = run(capsys, str(other))
    assert code == REFUSED and "no flight file" in told
    code, told = run(capsys, str(HERE / "limit.flight"), "--speed", "2")
    assert code == USAGE and "--view" in told


def test_can_buses_are_refused_with_what_to_do(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    recorded = load(HERE / "limit.flight")
    description = dict(recorded.briefing.description)
    description["buses"] = [{**bus, "kind": "can"} for bus in description["buses"]]
    briefing = msgspec.structs.replace(recorded.briefing, description=description)
    path = tmp_path / "can.flight"
    save(path, {}, msgspec.msgpack.encode(briefing), recorded.contents)
    code, told = run(capsys, str(path))
    assert code == REFUSED and "CAN bus" in told and "--view" in told


def test_a_robot_that_cannot_be_shown_is_refused_in_words(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def never(*_: Any, **__: Any) -> int:
        raise AssertionError("a page of no robot")

    monkeypatch.setattr(viewing, "show", never)
    recorded = load(HERE / "limit.flight")
    description = {key: value for key, value in recorded.briefing.description.items() if key != "poses"}
    briefing = msgspec.structs.replace(recorded.briefing, description=description)
    path = tmp_path / "foreign.flight"
    save(path, {}, msgspec.msgpack.encode(briefing), recorded.contents)
    code, told = run(capsys, "--view", str(path))
    assert code == REFUSED and "cannot be shown" in told and "poses" in told


def test_a_recording_whose_files_are_no_files_is_refused_in_words(tmp_path: Path) -> None:
    briefing = load(HERE / "limit.flight").briefing
    for place, path in enumerate(("/" + "x" * 300, "/a\0b")):
        folder = tmp_path / str(place)
        folder.mkdir()
        with pytest.raises(Unplayable, match="cannot be laid out"):
            lay_out(msgspec.structs.replace(briefing, texts={**briefing.texts, path: "x"}), folder)


def test_help_says_what_it_does_not_touch(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["replay", "--help"])
    told = " ".join(capsys.readouterr().out.split())
    assert "No port of this machine is opened" in told and "CAN buses" in told


def test_the_viewer_is_given_the_states_at_the_pace_at_which_they_were() -> None:
    recording = open_recording(HERE / "limit.flight")
    clock = FakeClock(50.0)
    seen = [(clock.now(), each) for each in messages(recording, clock, 2.0)]
    times = [each["time"] for _, each in seen]
    assert times == sorted(times)
    assert {each["topic"] for _, each in seen} >= {"state", "status", "events", "verdicts"}
    first, last = seen[0], seen[-1]
    assert last[0] - first[0] == pytest.approx((last[1]["time"] - first[1]["time"]) / 2.0)
    state = next(each for _, each in seen if each["topic"] == "state")
    assert [row["name"] for row in state["joints"]][:1] == ["head_yaw"]
    json.dumps([each for _, each in seen], allow_nan=False)


def test_the_last_seconds_can_be_played_alone() -> None:
    recorded = load(HERE / "limit.flight")
    whole, last = score(recorded), score(recorded, 1.5)
    assert last.begin > whole.begin
    assert len(last.commands) < len(whole.commands)


@pytest.mark.parametrize("mode", [Mode.SIM, Mode.MIRROR])
def test_where_commands_go_to_the_simulation_the_same_comes_out_too(mode: Mode, tmp_path: Path) -> None:
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
