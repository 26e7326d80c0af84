"""Refusals and reports of `twindctl replay`: untrusted files, no access to files of the user."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from tests.support.golden_captures import HERE, cut, expected
from twind import link
from twind.briefing import Briefing
from twind.command_line.verb import DONE, REFUSED, USAGE
from twind.ctl.ctl_main import main
from twind.exceptions import OperationFailed
from twind.flight import EntryKind, FlightContents, FlightEntry, load, save
from twind.observe import replay, viewing
from twind.observe.recording import open_recording
from twind.observe.recording.recording_columns import ExternalColumns
from twind.observe.replaying.recorded_states import messages
from twind.observe.replaying.replay_calls import call
from twind.observe.replaying.replay_files import lay_out
from twind.observe.replaying.replay_script import score
from twind_drivers.clock import FakeClock

Run = Callable[..., tuple[int, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the verb; return its exit code and output."""

    def verb(*arguments: str) -> tuple[int, str]:
        code = main(["replay", *arguments])
        output = capsys.readouterr()
        return code, output.out + output.err

    return verb


@pytest.fixture
def replayed(run: Run, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Report a replay in which nothing differs but the changes to its script."""

    def report(*, verbatim: float = 0.7, missed: int = 0, **changes: Any) -> tuple[int, str]:
        script = replace(score(load(HERE / "limit.flight")), **changes)
        result = replay.ReplayResult(script, expected("limit"), verbatim, missed)
        monkeypatch.setattr(replay, "_play", lambda *_, **__: result)
        return run(str(HERE / "limit.flight"))

    return report


def test_equality_is_reported_only_for_the_replayed_part(replayed: Run) -> None:
    code, text = replayed()
    assert code == DONE and "replayed: the same" in text and "time for every tick" in text
    code, text = replayed(missed=3)
    assert code == DONE and "no time for 3 ticks" in text
    code, text = replayed(verbatim=0.0)
    assert code == REFUSED and "the same (" not in text and "no question had its recorded answer" in text
    code, text = replayed(whole=False, left_out=("a reload",))
    assert code == REFUSED and "the same (" not in text and "not all was asked again" in text
    recorded = expected("limit")
    first = replace(recorded.answers[0], answered=False)
    code, text = replayed(recorded=replace(recorded, answers=(first, *recorded.answers[1:])))
    assert code == DONE and "not compared, 1:" in text and "command 1" in text


def test_the_verdict_comes_before_the_commands_of_the_recording(replayed: Run) -> None:
    _, text = replayed(left_out=("a reload",))
    assert text.index("replayed: the same") < text.index("not asked again") < text.index("recorded:")


def test_text_from_a_flight_file_cannot_control_the_terminal(replayed: Run) -> None:
    code, text = replayed(left_out=("\x1b[2Jreplayed\nreplayed: different",))
    assert code == DONE and "\x1b" not in text
    assert not any(line.startswith("replayed: different") for line in text.splitlines())


def test_a_recording_without_a_moment_at_rest_is_refused() -> None:
    recorded = load(HERE / "silent.flight")
    begin = recorded.contents.entries[-1].time - 0.5
    with pytest.raises(OperationFailed, match=r"no moment to begin at: .* fault.*--view"):
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
    """A briefing that names these buses, whatever its robot file contains."""
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
    with pytest.raises(OperationFailed, match=r"recorded were .*--robot FILE"):
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
    with pytest.raises(OperationFailed, match="extra"):
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


def test_a_recording_without_its_robot_file_names_the_option(tmp_path: Path) -> None:
    briefing = msgspec.structs.replace(load(HERE / "limit.flight").briefing, texts={})
    with pytest.raises(OperationFailed, match="--robot FILE"):
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


def test_a_file_that_is_no_flight_file_is_a_usage_error(run: Run, tmp_path: Path) -> None:
    code, text = run(str(tmp_path / "run.mcap"))
    assert code == USAGE and "no bytes" in text and "--view" in text
    other = tmp_path / "other.flight"
    other.write_bytes(b"something else")
    code, text = run(str(other))
    assert code == REFUSED and "no flight file" in text
    code, text = run(str(HERE / "limit.flight"), "--speed", "2")
    assert code == USAGE and "--view" in text


def test_can_buses_are_refused_with_what_to_do(run: Run, tmp_path: Path) -> None:
    recorded = load(HERE / "limit.flight")
    description = dict(recorded.briefing.description)
    description["buses"] = [{**bus, "kind": "can"} for bus in description["buses"]]
    briefing = msgspec.structs.replace(recorded.briefing, description=description)
    path = tmp_path / "can.flight"
    save(path, {}, msgspec.msgpack.encode(briefing), recorded.contents)
    code, text = run(str(path))
    assert (
        code == REFUSED
        and "of kind can: only buses of kind dynamixel2 are played" in text
        and "--view" in text
    )


def test_a_robot_that_cannot_be_shown_is_refused_in_words(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def never(*_: Any, **__: Any) -> int:
        raise AssertionError("a page of no robot")

    monkeypatch.setattr(viewing, "show", never)
    recorded = load(HERE / "limit.flight")
    description = {key: value for key, value in recorded.briefing.description.items() if key != "poses"}
    briefing = msgspec.structs.replace(recorded.briefing, description=description)
    path = tmp_path / "foreign.flight"
    save(path, {}, msgspec.msgpack.encode(briefing), recorded.contents)
    code, text = run("--view", str(path))
    assert code == REFUSED and "cannot be shown" in text and "poses" in text


def test_a_recording_whose_files_are_no_files_is_refused_in_words(tmp_path: Path) -> None:
    briefing = load(HERE / "limit.flight").briefing
    for place, path in enumerate(("/" + "x" * 300, "/a\0b")):
        folder = tmp_path / str(place)
        folder.mkdir()
        with pytest.raises(OperationFailed, match="cannot be laid out"):
            lay_out(msgspec.structs.replace(briefing, texts={**briefing.texts, path: "x"}), folder)


def test_the_viewer_is_given_the_states_at_the_pace_at_which_they_were() -> None:
    recording = open_recording(HERE / "limit.flight")
    clock = FakeClock(50.0)
    seen = [(clock.now(), each) for each in messages(recording, clock, 2.0)]
    times = [each["time"] for _, each in seen]
    assert times == sorted(times)
    assert {each["topic"] for _, each in seen} >= {"state", "status", "events", "verdicts"}
    first = seen[0]
    last = seen[-1]
    assert last[0] - first[0] == pytest.approx((last[1]["time"] - first[1]["time"]) / 2.0)
    state = next(each for _, each in seen if each["topic"] == "state")
    assert [row["name"] for row in state["joints"]][:1] == ["head_yaw"]
    json.dumps([each for _, each in seen], allow_nan=False)


def test_the_viewer_is_given_the_last_known_torque_from_outside() -> None:
    recording = open_recording(HERE / "limit.flight")
    assert recording.external is None
    shape = (1, len(recording.joints))
    since = float(recording.time[len(recording.time) // 2])
    felt = ExternalColumns(np.array([since]), np.full(shape, 1.5), np.full(shape, 0.1), np.ones(shape, bool))
    states = [
        each for each in messages(replace(recording, external=felt), FakeClock(), 1.0) if "joints" in each
    ]
    for each in states:
        told = [row.get("external_nm") for row in each["joints"]]
        assert told == [1.5 if each["time"] >= since else None] * shape[1]
    assert states[-1]["joints"][0]["contact"] is True


def test_the_last_seconds_can_be_played_alone() -> None:
    recorded = load(HERE / "limit.flight")
    whole = score(recorded)
    last = score(recorded, 1.5)
    assert last.begin > whole.begin
    assert len(last.commands) < len(whole.commands)


@pytest.mark.parametrize(("kind", "what"), [(EntryKind.NEWS, "messages"), (EntryKind.COMMAND, "commands")])
def test_a_flight_file_with_unknown_entries_is_not_replayed(kind: EntryKind, what: str) -> None:
    recorded = load(HERE / "limit.flight")
    entries = recorded.contents.entries
    foreign = FlightEntry(entries[-1].time, kind, 255, b"\xc1 of a later version")
    contents = FlightContents(recorded.contents.kept, (*entries, foreign))
    with pytest.raises(OperationFailed, match=f"does not read the {what}"):
        score(replace(recorded, contents=contents))
